"""Exact planning in finite tasks, for thousands of them at once: V*, Q* and the optimal actions. The oracle.

All functions are for one task; map them over a stack of tasks, or use `solve_all`. Values shrink by γ with every step
to the reward, and precision is relative to the size of each value. Below 1e-38, which is γ to the 829th at 0.9, single
precision has only zero, and all actions look alike: plan such tasks under `jax.enable_x64`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from upslope.equations.shaping import shaping_reward
from upslope.types import Task

ActionValues = Float[Array, "states actions"]
#: V, and the sizes of the numbers that were added to get it.
Backup = tuple[Float[Array, "states"], Float[Array, "states"]]

#: The maximum relative change of a number by rounding to single precision.
ROUNDING = 1.2e-7

#: The maximum number of iterations of planning, unless there are more states.
PATIENCE = 10_000


class TabularMDP(eqx.Module):
    """A finite task as tables of the possible outcomes of every action in every state.

    Attributes:
        successors: s' ``[states, actions, outcomes]``.
        probabilities: P(s' | s, a); they add up to one over the outcomes.
        rewards: R(s, a, s').
        discounts: d = γ·(1 − terminated), the factor of the value of s'.
        acting: states in which the agent acts ``[states]``: not terminal states, and not cells such as obstacles.
    """

    successors: Int[Array, "*tasks states actions outcomes"]
    probabilities: Float[Array, "*tasks states actions outcomes"]
    rewards: Float[Array, "*tasks states actions outcomes"]
    discounts: Float[Array, "*tasks states actions outcomes"]
    acting: Bool[Array, "*tasks states"]


class Solution(NamedTuple):
    """The result of value iteration.

    Attributes:
        value: V* ``[states]``, zero where the agent does not act.
        action_value: Q* ``[states, actions]``, zero where the agent does not act.
        residual: the largest change of V in the last iteration; V is within γ/(1 − γ) times this of V*.
        iterations: the number of iterations.
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
    outcomes = env.outcomes(task)
    discounts = gamma * (1.0 - outcomes.terminated)
    return TabularMDP(outcomes.successors, outcomes.probabilities, outcomes.rewards, discounts, outcomes.acting)


def value_iteration(mdp: TabularMDP, *, tolerance: float = ROUNDING, max_iterations: int | None = None) -> Solution:
    """V* and Q* by Bellman's optimality equation, from V = 0.

    Args:
        mdp: one task.
        tolerance: iteration stops when no value changed by more than this, relative to the sizes of the numbers that
            were added to get it. A change from zero is always more. In deterministic tasks with one reward, values
            stop changing completely. Where staying is best and earns nothing, values can shrink by γ each time and
            never settle: set ``max_iterations``.
        max_iterations: iteration stops after this number; see the residual. If None: `PATIENCE`, or the number of
            states if that is larger.
    """

    def greedy(q: ActionValues, sizes: ActionValues) -> Backup:
        value = jnp.max(q, axis=-1)
        return value, jnp.max(sizes, axis=-1, where=q == value[:, None], initial=0.0)

    value, residual, count = _iterate(mdp, greedy, tolerance, max_iterations)
    return Solution(value, lookahead(mdp, value), residual, count)


def lookahead(mdp: TabularMDP, value: Float[Array, "states"]) -> ActionValues:
    """Σ P(s' | s, a)·(R + d·V(s')), which is Q* if V is V*; zero where the agent does not act."""
    return _lookahead(mdp, value)[0]


def _lookahead(mdp: TabularMDP, value: Float[Array, "states"]) -> tuple[ActionValues, ActionValues]:
    """`lookahead`, and the sizes of what it adds: where large numbers cancel, rounding must not count as a change."""
    future = mdp.discounts * value[mdp.successors]
    q = jnp.sum(mdp.probabilities * (mdp.rewards + future), axis=-1)
    sizes = jnp.sum(mdp.probabilities * (jnp.abs(mdp.rewards) + jnp.abs(future)), axis=-1)
    return jnp.where(mdp.acting[:, None], q, 0.0), sizes


def evaluate_policy(
    mdp: TabularMDP, policy: ActionValues, *, tolerance: float = ROUNDING, max_iterations: int | None = None
) -> Float[Array, "states"]:
    """The value of a policy, given as the probability of each action in each state; see `value_iteration`."""

    def expected(*numbers: ActionValues) -> Backup:
        value, size = (jnp.sum(policy * number, axis=-1) for number in numbers)
        return value, size

    return _iterate(mdp, expected, tolerance, max_iterations)[0]


def _iterate(
    mdp: TabularMDP,
    back_up: Callable[[ActionValues, ActionValues], Backup],
    tolerance: float,
    max_iterations: int | None,
) -> tuple[Float[Array, "states"], Float[Array, ""], Int[Array, ""]]:
    """Backups from V = 0 on: V, the largest change in the last iteration, and the number of iterations."""
    limit = max(PATIENCE, mdp.acting.shape[-1]) if max_iterations is None else max_iterations

    def is_moving(carry: tuple) -> Bool[Array, ""]:
        *_, moving, count = carry
        return moving & (count < limit)

    def iterate(carry: tuple) -> tuple:
        value, *_, count = carry
        new_value, sizes = back_up(*_lookahead(mdp, value))
        change = jnp.abs(new_value - value)
        return new_value, jnp.max(change), jnp.any(change > tolerance * sizes), count + 1

    start = jnp.zeros(mdp.acting.shape, jnp.result_type(mdp.rewards, mdp.discounts, mdp.probabilities))
    before = (start, jnp.full((), jnp.inf, start.dtype), jnp.ones((), bool), jnp.zeros((), jnp.int32))
    value, residual, _, count = jax.lax.while_loop(is_moving, iterate, before)
    return value, residual, count


def steps_to_reward(mdp: TabularMDP) -> Int[Array, "states"]:
    """Steps to the nearest positive reward, for the luckiest outcomes if they are random; −1 if none can be reached.

    Paths avoid states in which the agent does not act, such as traps.
    """
    possible = mdp.probabilities > 0
    rewarded, continues = possible & (mdp.rewards > 0), possible & (mdp.discounts > 0)

    def spread(carry: tuple) -> tuple:
        steps, _, count = carry
        ways = rewarded | (continues & (steps >= 0)[mdp.successors])
        reached = mdp.acting & jnp.any(ways, axis=(-2, -1)) & (steps < 0)
        return jnp.where(reached, count, steps), jnp.any(reached), count + 1

    unreached = jnp.full(mdp.acting.shape, -1, jnp.int32)
    before = (unreached, jnp.ones((), bool), jnp.ones((), jnp.int32))
    return jax.lax.while_loop(lambda carry: carry[1], spread, before)[0]


def can_earn(mdp: TabularMDP) -> Bool[Array, "states"]:
    """Whether some positive reward can still be reached, at any distance; false where the agent does not act."""
    return steps_to_reward(mdp) > 0


def best_actions(
    scores: Float[Array, "*states actions"], *, relative: float = 1e-5, absolute: float = 0.0
) -> Bool[Array, "*states actions"]:
    """The set of actions whose score is the highest up to rounding: the optimal actions if the scores are Q*.

    Args:
        scores: the score of every action ``[..., actions]``.
        relative: tolerance relative to the highest score; far from a reward all scores are small.
        absolute: absolute tolerance, for scores that are small because large numbers cancel.
    """
    highest = jnp.max(scores, axis=-1, keepdims=True)
    return scores >= highest - (relative * jnp.abs(highest) + absolute)


def immediate_rewards(mdp: TabularMDP) -> ActionValues:
    """E[R(s, a, s')], which is all that an agent without lookahead sees."""
    return jnp.sum(mdp.probabilities * mdp.rewards, axis=-1)


def shape_mdp(mdp: TabularMDP, potential: Float[Array, "states"]) -> TabularMDP:
    """The task with R' = R + F (Def. 2.1), F from a table of Φ; unchanged where the agent does not act."""
    f = shaping_reward(potential[:, None, None], mdp.discounts, potential[mdp.successors])
    rewards = mdp.rewards + jnp.where(mdp.acting[:, None, None], f, 0.0)
    return eqx.tree_at(lambda mdp: mdp.rewards, mdp, rewards)


@eqx.filter_jit
def solve_all(env: Any, tasks: Task, gamma: float) -> Solution:
    """V* and Q* of ``n`` stacked tasks of a finite environment ``[n, ...]``."""
    return jax.vmap(lambda task: value_iteration(tabulate(env, task, gamma)))(tasks)
