"""A look at a family before meta-training: what would make it fail silently or with a strange error later."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from upslope.errors import PriorWarning, UpslopeError
from upslope.learners.policies import EpsilonGreedy
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import head_class
from upslope.tasks.family import AbstractFamily
from upslope.types import Key

#: How many tasks are drawn, on how many of them random steps are taken, and how many at most.
_DRAWN, _PLAYED, _STEPS = 10, 4, 50


def look_at(family: AbstractFamily, key: Key) -> None:
    """Draws a few tasks and takes a few random steps.

    Warns:
        PriorWarning: all tasks are the same.

    Raises:
        UpslopeError: an observation or a reward is not a finite number, or observations never change.
    """
    task_key, network_key, key = jax.random.split(key, 3)
    tasks = family.sample_many(task_key, _DRAWN)
    if _are_equal(family, tasks):
        warnings.warn(
            f"All {_DRAWN} tasks that were drawn of {family.name!r} are the same: let the sampler vary what new tasks "
            "will differ in, or the prior fits only this one.",
            PriorWarning,
            stacklevel=3,
        )
    head = head_class(None, family.actions.kind)
    network = DuelingQ(network_key, family.observation_shape, family.actions.count, (1,), head=head)
    played = jax.tree.map(lambda leaf: leaf[:_PLAYED], tasks)
    policy = EpsilonGreedy(network, jnp.ones(_PLAYED))
    seen = family.rollout(key, played, policy, min(family.max_steps, _STEPS))
    obs, reward = np.asarray(seen.obs), np.asarray(seen.reward)
    _check_finite(family, "observation", obs)
    _check_finite(family, "observation", np.asarray(seen.next_obs))
    _check_finite(family, "reward", reward)
    if (obs == obs[:1, :1]).all():
        raise UpslopeError(
            f"Observations of {family.name!r} never change, on {_PLAYED} tasks and in {obs.shape[1]} random steps: a "
            "potential of them can only be a constant. Let the environment observe its state."
        )


def _are_equal(family: AbstractFamily, tasks: Any) -> bool:
    """Whether all of the stacked tasks are the same, as far as they can be compared."""
    one_by_one = (family.task_of(jax.tree.map(lambda leaf, at=i: leaf[at], tasks)) for i in range(_DRAWN))
    return len({repr(jax.tree.map(str, task)) for task in one_by_one}) == 1


def _check_finite(family: AbstractFamily, what: str, numbers: np.ndarray) -> None:
    bad = ~np.isfinite(numbers)
    if bad.any():
        raise UpslopeError(
            f"{family.name!r} gave the {what} {numbers[bad][0]} in its first random steps: fix the environment, or "
            "replace what is missing by a number."
        )
