"""Thm. 3.1 on maps: with Φ = V* immediate shaped rewards are at most zero, and zero exactly for optimal actions."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.experiments.theorems.maps import TOLERANCE, Maps, exact_truth, for_each
from upslope.planning.exact import best_actions, immediate_rewards, shape_mdp
from upslope.planning.grid_potentials import manhattan_values
from upslope.planning.measures import success
from upslope.types import Key

#: Standard deviations of the noise on V*; the reward for the goal is 1.
NOISE = (0.0, 0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5)

#: Immediate rewards nearer to zero than this count as zero; values are exact to `TOLERANCE`.
ZERO = 10 * TOLERANCE


def credit_assignment(maps: Maps, seed: int) -> dict[str, Any]:
    """The immediate shaped rewards of an agent that does not look ahead, with Φ = V* and with other potentials.

    Returns:
        The numbers of ``maps``, ``states`` and ``optimal_actions``; the largest absolute expected shaped reward of an
        optimal action, ``optimal_size``; the largest expected shaped reward of any other action, ``other_largest``; the
        largest shaped reward of a single outcome, ``single_largest``, which is above zero with slippery moves; and
        ``solved``, by potential: the share of maps solved within 50 steps by following the best immediate reward.
    """
    count = len(maps.params.start)
    keys = jax.random.split(jax.random.key(seed), count)
    results = for_each(lambda params, key: _one_map(maps, params, key), maps.params, keys)
    return {
        "maps": count,
        "states": int(results["states"].sum()),
        "optimal_actions": int(results["optimal_actions"].sum()),
        "optimal_size": float(results["optimal_size"].max()),
        "other_largest": float(results["other_largest"].max()),
        "single_largest": float(results["single_largest"].max()),
        "sets_equal": float(np.mean(results["sets_equal"])),
        "solved": {
            "V*": float(results["noisy"][:, 0].mean()),
            "Manhattan": float(results["manhattan"].mean()),
            "none": float(results["none"].mean()),
        },
        "noise": list(NOISE),
        "solved_by_noise": results["noisy"].mean(axis=0).tolist(),
    }


def _one_map(maps: Maps, params: Any, key: Key) -> dict[str, Array]:
    truth = exact_truth(maps, params)
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
