"""One episode on each of some tasks, and what a network says of every step of it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from upslope.meta_training.statistics import discounted_returns, joined
from upslope.networks.dueling import AbstractDueling
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Policy, Task, Transition


class Episodes(eqx.Module):
    """One episode on each of ``n`` tasks, as far as it goes within ``steps`` steps.

    Attributes:
        returns: raw and undiscounted ``[n]``.
        discounted: the discounted returns ``[n]``; where a time limit ended the episode, V of the last state stands for
            what would have followed.
        terminated: whether the environment ended it, not a time limit ``[n]``.
        rewards: of each step, raw ``[n, steps]``.
        counts: which steps belong to the episode ``[n, steps]``.
        values: V of each state ``[n, steps]``.
        td_errors: r + d·V(s') − Q(s, a) of each step ``[n, steps]``.
    """

    returns: Float[Any, "n"]
    discounted: Float[Any, "n"]
    terminated: Bool[Any, "n"]
    rewards: Float[Any, "n steps"]
    counts: Bool[Any, "n steps"]
    values: Float[Any, "n steps"]
    td_errors: Float[Any, "n steps"]

    @property
    def start_values(self) -> Float[np.ndarray, "n"]:
        """V of each first state."""
        return self.values[:, 0]


def play(family: AbstractFamily, key: Key, tasks: Task, policy: Policy, network: AbstractDueling) -> Episodes:
    """Runs a policy for one episode on each of ``n`` stacked tasks; the results are NumPy arrays."""
    seen = family.rollout(key, tasks, policy, family.max_steps)
    return jax.tree.map(np.asarray, first_episodes(network, seen))


@eqx.filter_jit
def first_episodes(network: AbstractDueling, seen: Transition) -> Episodes:
    """The first episode of each row of transitions ``[n, steps, ...]``."""
    goes_on = joined(seen) & (seen.discount > 0)
    before = jnp.concatenate([jnp.ones_like(goes_on[:, :1]), goes_on[:, :-1]], axis=1)
    counts = jnp.cumprod(before, axis=1).astype(bool)
    is_last = counts & ~goes_on
    over_steps = lambda function: jax.vmap(jax.vmap(function))  # noqa: E731
    next_values = seen.discount * over_steps(network.value)(seen.next_obs)
    with_tail = seen._replace(reward=seen.reward + jnp.where(is_last, next_values, 0.0))
    return Episodes(
        returns=jnp.sum(seen.reward * counts, axis=1),
        discounted=discounted_returns(with_tail)[:, 0],
        terminated=jnp.any(is_last & (seen.discount == 0), axis=1),
        rewards=seen.reward,
        counts=counts,
        values=over_steps(network.value)(seen.obs),
        td_errors=seen.reward + next_values - over_steps(network.q)(seen.obs, seen.action),
    )


def repeated(tasks: Task, times: int) -> Task:
    """Each task ``times`` times in a row ``[n · times, ...]``."""
    return jax.tree.map(lambda leaf: jnp.repeat(leaf, times, axis=0), tasks)


def per_task(numbers: Float[Any, "n"], times: int) -> Float[np.ndarray, "tasks"]:
    """The mean over each task's episodes, if each task was repeated ``times`` times in a row."""
    return numbers.reshape(-1, times).mean(1)
