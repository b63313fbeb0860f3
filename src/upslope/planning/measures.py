"""How close a learned V and Q are to V* and Q* on finite tasks. Nothing is sampled: every number is exact.

Functions are for one task and its tables of numbers per state; `measure_all` takes a network and a stack of tasks.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from upslope.planning.exact import (
    Solution,
    TabularMDP,
    best_actions,
    can_earn,
    evaluate_policy,
    tabulate,
    value_iteration,
)
from upslope.types import Scalar, Task

States = Float[Array, "states"]
StatesMask = Bool[Array, "states"]
ActionValues = Float[Array, "states actions"]


class Truth(eqx.Module):
    """The exact values of one task, computed once and used at every evaluation.

    Attributes:
        mdp: the task as tables.
        solution: V* and Q*.
        states: the states that count: the agent acts there, and some reward can still be reached.
        start: the first state of episodes.
    """

    mdp: TabularMDP
    solution: Solution
    states: Bool[Array, "*tasks states"]
    start: Int[Array, "*tasks"]


class Measures(NamedTuple):
    """One number per task ``[*tasks]``.

    Attributes:
        rank_correlation: Spearman's rank correlation of V with V* over the states that count. It is 1 if V has the
            right order everywhere.
        squared_error: the mean of (V − V*)² over these states (Eq. 4).
        action_optimality: the share of these states in which the greedy action of Q is optimal.
        success: the probability that the greedy policy earns a positive reward within an episode.
        discounted_return: the discounted return of the greedy policy from the start, within an episode.
        optimal_return: V* of the start.
    """

    rank_correlation: Float[Array, "*tasks"]
    squared_error: Float[Array, "*tasks"]
    action_optimality: Float[Array, "*tasks"]
    success: Float[Array, "*tasks"]
    discounted_return: Float[Array, "*tasks"]
    optimal_return: Float[Array, "*tasks"]


def truth(env: Any, task: Task, gamma: float) -> Truth:
    """Plans in one task of a finite environment whose tasks have a ``start``."""
    mdp = tabulate(env, task, gamma)
    return Truth(mdp, value_iteration(mdp), can_earn(mdp), task.start)


@eqx.filter_jit
def truths(env: Any, tasks: Task, gamma: float) -> Truth:
    """`truth` of ``n`` stacked tasks ``[n, ...]``."""
    return jax.vmap(lambda task: truth(env, task, gamma))(tasks)


def measure(exact: Truth, value: States, q: ActionValues, steps: int) -> Measures:
    """All measures of one task.

    Args:
        exact: the exact values of the task.
        value: the learned V of every state.
        q: the learned Q, or any other scores of the actions, of every state.
        steps: the maximum length of an episode.
    """
    greedy = jax.nn.one_hot(jnp.argmax(q, axis=-1), q.shape[-1])
    return Measures(
        rank_correlation(value, exact.solution.value, exact.states),
        _mean((value - exact.solution.value) ** 2, exact.states),
        action_optimality(q, exact.solution.action_value, exact.states),
        success(exact.mdp, greedy, steps)[exact.start],
        evaluate_policy(exact.mdp, greedy, tolerance=0.0, max_iterations=steps)[exact.start],
        exact.solution.value[exact.start],
    )


@eqx.filter_jit
def measure_all(env: Any, exact: Truth, tasks: Task, network: Any, steps: int) -> Measures:
    """All measures of a network on ``n`` stacked tasks ``[n, ...]``.

    Args:
        env: has ``observe_all(task)``, the observations of all states.
        exact: `truths` of the tasks.
        tasks: the tasks.
        network: maps one observation to Q(s, ·); its ``value`` gives V(s).
        steps: the maximum length of an episode.
    """

    def of_one(exact: Truth, task: Task) -> Measures:
        return measure(exact, *tables(env, task, network), steps)

    return jax.vmap(of_one)(exact, tasks)


def tables(env: Any, task: Task, network: Any) -> tuple[States, ActionValues]:
    """A network's V and Q in every state of one task."""
    observations = env.observe_all(task)
    return jax.vmap(network.value)(observations), jax.vmap(network)(observations)


def rank_correlation(ours: States, theirs: States, states: StatesMask) -> Scalar:
    """Spearman's rank correlation over some states; ties share their mean rank; 0 if either side is constant."""
    x, y = _ranks(ours, states), _ranks(theirs, states)
    x, y = x - _mean(x, states), y - _mean(y, states)
    spread = jnp.sqrt(_mean(x**2, states) * _mean(y**2, states))
    return jnp.where(spread > 0, _mean(x * y, states) / jnp.where(spread > 0, spread, 1.0), 0.0)


def action_optimality(q: ActionValues, optimal_q: ActionValues, states: StatesMask) -> Scalar:
    """Share of some states in which the action with the highest Q (the first one among ties) is optimal."""
    greedy = jnp.argmax(q, axis=-1, keepdims=True)
    is_best = jnp.take_along_axis(best_actions(optimal_q), greedy, axis=-1)[:, 0]
    return _mean(is_best.astype(q.dtype), states)


def episode_values(mdp: TabularMDP, policy: ActionValues, steps: int) -> tuple[States, States]:
    """The expected raw return of a policy within ``steps`` steps from every state: undiscounted, and discounted."""
    undiscounted = eqx.tree_at(lambda mdp: mdp.discounts, mdp, jnp.sign(mdp.discounts))
    raw = evaluate_policy(undiscounted, policy, tolerance=0.0, max_iterations=steps)
    return raw, evaluate_policy(mdp, policy, tolerance=0.0, max_iterations=steps)


def success(mdp: TabularMDP, policy: ActionValues, steps: int) -> States:
    """The probability, from every state, that a policy earns a positive reward within ``steps`` steps."""
    undiscounted = eqx.tree_at(lambda mdp: mdp.discounts, _positive_rewards_only(mdp), jnp.sign(mdp.discounts))
    return evaluate_policy(undiscounted, policy, tolerance=0.0, max_iterations=steps)


def feature_norm(features: Float[Array, "states units"]) -> Scalar:
    """Root mean square of the features. Algorithm 1 as printed drives it to zero."""
    return jnp.sqrt(jnp.mean(features**2))


def dead_units(features: Float[Array, "states units"], *, tolerance: float = 1e-6) -> Scalar:
    """Share of units with the same output in every state, such as a ReLU that is never active."""
    return jnp.mean((jnp.ptp(features, axis=0) <= tolerance).astype(features.dtype))


def summarise(measures: Measures) -> dict[str, dict[str, float]]:
    """Mean, median and worst of each measure over tasks ``[n]``; the worst is the lowest, or for errors the largest."""
    worst: dict[str, Callable] = {"squared_error": np.max}
    return {
        name: {
            "mean": float(np.mean(numbers)),
            "median": float(np.median(numbers)),
            "worst": float(worst.get(name, np.min)(numbers)),
        }
        for name, numbers in zip(Measures._fields, map(np.asarray, measures), strict=True)
    }


def _positive_rewards_only(mdp: TabularMDP) -> TabularMDP:
    """The same task with a reward of 1 for every positive reward, and 0 for all others."""
    return eqx.tree_at(lambda mdp: mdp.rewards, mdp, (mdp.rewards > 0).astype(mdp.rewards.dtype))


def _ranks(numbers: States, states: StatesMask) -> States:
    below = (numbers[None, :] < numbers[:, None]) & states
    equal = (numbers[None, :] == numbers[:, None]) & states
    return jnp.sum(below, axis=1) + 0.5 * jnp.sum(equal, axis=1)


def _mean(numbers: States, states: StatesMask) -> Scalar:
    return jnp.sum(numbers, where=states) / jnp.maximum(jnp.sum(states), 1)
