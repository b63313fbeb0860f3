"""Thm. 3.1 on maps: with Φ = V* immediate shaped rewards are at most zero, and zero exactly for optimal actions."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.experiments.theorems.maps import TOLERANCE, Maps, for_each, known
from upslope.planning.exact import best_actions, immediate_rewards, shape_mdp
from upslope.planning.grid_potentials import manhattan_values
from upslope.planning.measures import success
from upslope.types import Key

#: Standard deviations of the noise on V*; the reward for the goal is 1.
NOISE = (0.0, 0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5)

#: Immediate rewards nearer to zero than this count as zero; exact values are `TOLERANCE` away at most.
ZERO = 10 * TOLERANCE


def credit_assignment(maps: Maps, seed: int) -> dict[str, Any]:
    """What an agent that looks no step ahead is told, and how far it gets, with Φ = V* and with other potentials.

    Returns:
        ``maps``; ``states`` and ``optimal_actions`` looked at; the largest size of an optimal action's expected shaped
        reward, ``optimal_size``; the largest of any other action, ``other_largest``; the largest reward of a single
        outcome, ``single_largest``, which slippery moves lift above zero; and ``solved``, by potential: the share of
        maps that the best immediate reward alone leads through, within 50 steps.
    """
    count = len(maps.params.start)
    keys = jax.random.split(jax.random.key(seed), count)
    found = for_each(lambda params, key: _one_map(maps, params, key), maps.params, keys)
    return {
        "maps": count,
        "states": int(found["states"].sum()),
        "optimal_actions": int(found["optimal_actions"].sum()),
        "optimal_size": float(found["optimal_size"].max()),
        "other_largest": float(found["other_largest"].max()),
        "single_largest": float(found["single_largest"].max()),
        "sets_equal": float(np.mean(found["sets_equal"])),
        "solved": {
            "V*": float(found["noisy"][:, 0].mean()),
            "Manhattan": float(found["manhattan"].mean()),
            "none": float(found["none"].mean()),
        },
        "noise": list(NOISE),
        "solved_by_noise": found["noisy"].mean(axis=0).tolist(),
    }


def _one_map(maps: Maps, params: Any, key: Key) -> dict[str, Array]:
    truth = known(maps, params)
    here = truth.states[:, None]
    optimal = best_actions(truth.solution.action_value, relative=0.0, absolute=ZERO) & here
    shaped = shape_mdp(truth.mdp, truth.solution.value)
    expected = immediate_rewards(shaped)
    possible = here[..., None] & (shaped.probabilities > 0)

    def solved(potential: Float[Array, "states"]) -> Array:
        best = best_actions(immediate_rewards(shape_mdp(truth.mdp, potential)), relative=0.0, absolute=ZERO)
        return success(truth.mdp, best / best.sum(axis=-1, keepdims=True), 50)[truth.start]

    noise = jax.random.normal(key, (len(NOISE), maps.env.cells))
    noisy = truth.solution.value + jnp.asarray(NOISE)[:, None] * noise
    return {
        "states": jnp.sum(truth.states),
        "optimal_actions": jnp.sum(optimal),
        "optimal_size": jnp.max(jnp.abs(expected), where=optimal, initial=0.0),
        "other_largest": jnp.max(expected, where=here & ~optimal, initial=-jnp.inf),
        "single_largest": jnp.max(shaped.rewards, where=possible, initial=-jnp.inf),
        "sets_equal": jnp.all(((jnp.abs(expected) <= ZERO) & here) == optimal),
        "noisy": jax.vmap(solved)(noisy),
        "manhattan": solved(manhattan_values(maps.env, params, maps.gamma)),
        "none": solved(jnp.zeros(maps.env.cells)),
    }
