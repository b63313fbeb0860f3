"""Thm. 2.1 on maps: F from a potential changes no optimal action; other added rewards do."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.equations.shaping import shaped_optimum, shaping_reward
from upslope.experiments.theorems.maps import TOLERANCE, Maps, exact_truth, for_each
from upslope.planning.exact import Solution, TabularMDP, best_actions, value_iteration
from upslope.planning.grid_potentials import manhattan_distance
from upslope.planning.measures import success
from upslope.types import Key

#: The wrong γ in F; the task's is 0.9.
OTHER_GAMMA = 0.99

#: The bound of R + F, in the variant that clips.
CLIP = 0.05

#: The maximum number of iterations of planning. Where staying is best and earns nothing, values shrink by γ each time
#: and never settle; after this many iterations they are off by 1e-22.
ITERATIONS = 500

POTENTIALS = ("random, 0.1", "random, 1", "distance")
ADDED = (
    "F = γΦ(s′) − Φ(s)",
    "Φ(terminal) not zeroed",
    f"γ = {OTHER_GAMMA} in F",
    "no γ in F",
    f"R + F clipped to ±{CLIP}",
    "only F > 0 added",
    "Φ(s′) alone",
)


def policy_invariance(maps: Maps, seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """For every potential and every way to add it: the share of maps in which the set of optimal actions changes.

    Returns:
        For each ``[potential][added]``: the share of ``changed`` maps; the share ``solved`` in 50 steps by acting
        optimally for the changed reward (uniformly among the best actions); and the largest ``error`` of
        Q' + Φ − Q* (Eq. 1).
    """
    keys = jax.random.split(jax.random.key(seed), len(maps.params.start))
    changed, solved, error = for_each(lambda params, key: _one_map(maps, params, key), maps.params, keys)
    return {
        potential: {
            added: {
                "changed": float(np.mean(changed[:, row, column])),
                "solved": float(np.mean(solved[:, row, column])),
                "error": float(np.max(error[:, row, column])),
            }
            for column, added in enumerate(ADDED)
        }
        for row, potential in enumerate(POTENTIALS)
    }


def _one_map(maps: Maps, params: Any, key: Key) -> tuple[Array, Array, Array]:
    truth = exact_truth(maps, params)
    noise = jax.random.normal(key, (maps.env.cells,))
    potentials = jnp.stack([0.1 * noise, noise, -0.1 * manhattan_distance(maps.env, params)])
    original = best_actions(truth.solution.action_value, relative=0.0, absolute=10 * TOLERANCE)

    def compare(mdp: TabularMDP, potential: Float[Array, "states"]) -> tuple[Array, Array, Array]:
        shaped: Solution = value_iteration(mdp, tolerance=TOLERANCE / 100, max_iterations=ITERATIONS)
        best = best_actions(shaped.action_value, relative=0.0, absolute=10 * TOLERANCE)
        changed = jnp.any(best != original, axis=-1, where=truth.states[:, None])
        policy = best / best.sum(axis=-1, keepdims=True)
        solved = success(truth.mdp, policy, 50)[truth.start]
        expected = shaped_optimum(truth.solution.action_value, potential[:, None])
        error = jnp.max(jnp.abs(shaped.action_value - expected), where=truth.states[:, None], initial=0.0)
        return jnp.any(changed), solved, error

    def all_ways(potential: Float[Array, "states"]) -> tuple[Array, Array, Array]:
        ways = jnp.stack(list(added_rewards(truth.mdp, potential, maps.gamma)))
        return jax.vmap(lambda rewards: compare(_with_rewards(truth.mdp, rewards), potential))(ways)

    return jax.vmap(all_ways)(potentials)


def added_rewards(mdp: TabularMDP, potential: Float[Array, "states"], gamma: float) -> tuple[Array, ...]:
    """R plus what is added, for each of `ADDED`; only the first is Def. 2.1."""
    here, there = potential[:, None, None], potential[mdp.successors]
    continues = jnp.sign(mdp.discounts)
    f = shaping_reward(here, mdp.discounts, there)
    return (
        mdp.rewards + f,
        mdp.rewards + shaping_reward(here, gamma, there),
        mdp.rewards + shaping_reward(here, OTHER_GAMMA * continues, there),
        mdp.rewards + shaping_reward(here, continues, there),
        jnp.clip(mdp.rewards + f, -CLIP, CLIP),
        mdp.rewards + jnp.maximum(f, 0.0),
        mdp.rewards + continues * there,
    )


def _with_rewards(mdp: TabularMDP, rewards: Array) -> TabularMDP:
    new_rewards = jnp.where(mdp.acting[:, None, None], rewards, mdp.rewards)
    return eqx.tree_at(lambda mdp: mdp.rewards, mdp, new_rewards)
