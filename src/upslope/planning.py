"""Exact planning in finite tasks, for thousands of them at once: V*, Q* and the optimal actions. The oracle.

All functions are for one task; map them over a stack of tasks, or use `solve_all`.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from upslope.shaping import shaping_reward
from upslope.types import Task


class TabularMDP(eqx.Module):
    """A finite task as tables of what can follow upon every action in every state.

    Attributes:
        successors: s' ``[states, actions, outcomes]``.
        probabilities: P(s' | s, a); they add up to one over the outcomes.
        rewards: R(s, a, s').
        discounts: d = γ·(1 − terminated), what multiplies all that follows upon s'.
        acting: states in which one acts ``[states]``: neither terminal nor out of reach by their nature.
    """

    successors: Int[Array, "*tasks states actions outcomes"]
    probabilities: Float[Array, "*tasks states actions outcomes"]
    rewards: Float[Array, "*tasks states actions outcomes"]
    discounts: Float[Array, "*tasks states actions outcomes"]
    acting: Bool[Array, "*tasks states"]


class Solution(NamedTuple):
    """What value iteration found.

    Attributes:
        value: V* ``[states]``, zero where one doesn't act.
        action_value: Q* ``[states, actions]``, zero where one doesn't act.
        residual: the largest change of V in the last iteration; V is within γ/(1 − γ) times that of V*.
        iterations: how many it took.
    """

    value: Float[Array, "*tasks states"]
    action_value: Float[Array, "*tasks states actions"]
    residual: Float[Array, "*tasks"]
    iterations: Int[Array, "*tasks"]


def tabulate(env: Any, task: Task, gamma: float) -> TabularMDP:
    """One task of a finite environment as tables.

    Args:
        env: has ``outcomes(task)``, as `upslope.envs.grid.GridGame` does.
        task: one task, unstacked.
        gamma: γ of the task.
    """
    found = env.outcomes(task)
    discounts = gamma * (1.0 - found.terminated)
    return TabularMDP(found.successors, found.probabilities, found.rewards, discounts, found.acting)


def value_iteration(mdp: TabularMDP, *, tolerance: float = 1e-7, max_iterations: int = 10_000) -> Solution:
    """V* and Q* by Bellman's optimality equation, from V = 0.

    Args:
        mdp: one task.
        tolerance: stops where no value changed by more. Deterministic tasks with one reward stop changing altogether.
        max_iterations: stops there in any case; the residual tells.
    """

    def is_moving(carry: tuple) -> Bool[Array, ""]:
        _, residual, count = carry
        return (residual > tolerance) & (count < max_iterations)

    def iterate(carry: tuple) -> tuple:
        value, _, count = carry
        following = jnp.max(lookahead(mdp, value), axis=-1)
        return following, jnp.max(jnp.abs(following - value)), count + 1

    start = jnp.zeros(mdp.acting.shape, jnp.result_type(mdp.rewards, mdp.discounts, mdp.probabilities))
    infinite = jnp.full((), jnp.inf, start.dtype)
    value, residual, count = jax.lax.while_loop(is_moving, iterate, (start, infinite, jnp.zeros((), jnp.int32)))
    return Solution(value, lookahead(mdp, value), residual, count)


def lookahead(mdp: TabularMDP, value: Float[Array, "states"]) -> Float[Array, "states actions"]:
    """Σ P(s' | s, a)·(R + d·V(s')), which is Q* if V is V*; zero where one doesn't act."""
    returns = mdp.rewards + mdp.discounts * value[mdp.successors]
    return jnp.where(mdp.acting[:, None], jnp.sum(mdp.probabilities * returns, axis=-1), 0.0)


def evaluate_policy(
    mdp: TabularMDP, policy: Float[Array, "states actions"], *, tolerance: float = 1e-7, max_iterations: int = 10_000
) -> Float[Array, "states"]:
    """The value of a policy, given as the probability of each action in each state."""

    def is_moving(carry: tuple) -> Bool[Array, ""]:
        _, residual, count = carry
        return (residual > tolerance) & (count < max_iterations)

    def iterate(carry: tuple) -> tuple:
        value, _, count = carry
        following = jnp.sum(policy * lookahead(mdp, value), axis=-1)
        return following, jnp.max(jnp.abs(following - value)), count + 1

    start = jnp.zeros(mdp.acting.shape, jnp.result_type(mdp.rewards, mdp.discounts, mdp.probabilities))
    infinite = jnp.full((), jnp.inf, start.dtype)
    return jax.lax.while_loop(is_moving, iterate, (start, infinite, jnp.zeros((), jnp.int32)))[0]


def best_actions(scores: Float[Array, "*states actions"], *, tolerance: float = 1e-5) -> Bool[Array, "*states actions"]:
    """The set of actions whose score is the highest but for rounding: the optimal actions if the scores are Q*."""
    return scores >= jnp.max(scores, axis=-1, keepdims=True) - tolerance


def immediate_rewards(mdp: TabularMDP) -> Float[Array, "states actions"]:
    """E[R(s, a, s')]: what an agent sees that looks no step ahead."""
    return jnp.sum(mdp.probabilities * mdp.rewards, axis=-1)


def shape_mdp(mdp: TabularMDP, potential: Float[Array, "states"]) -> TabularMDP:
    """The task with R' = R + F (Def. 2.1), F from a table of Φ; unchanged where one doesn't act."""
    # Φ(s) and Φ(s') stand in for the observations, so that Def. 2.1 itself does the sum.
    f = jnp.vectorize(lambda *values: shaping_reward(lambda value: value, *values))(
        potential[:, None, None], mdp.discounts, potential[mdp.successors]
    )
    rewards = mdp.rewards + jnp.where(mdp.acting[:, None, None], f, 0.0)
    return eqx.tree_at(lambda mdp: mdp.rewards, mdp, rewards)


@eqx.filter_jit
def solve_all(env: Any, tasks: Task, gamma: float) -> Solution:
    """V* and Q* of ``n`` stacked tasks of a finite environment ``[n, ...]``."""
    return jax.vmap(lambda task: value_iteration(tabulate(env, task, gamma)))(tasks)
