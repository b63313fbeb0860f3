"""A learner's own experience of one task: running environments and a replay of raw rewards."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.replay import Replay
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Policy, Scalar, Task, Transition


class Experience(eqx.Module):
    """One environment of one task, and the transitions seen there."""

    running: Any
    replay: Replay

    @classmethod
    def start(cls, key: Key, family: AbstractFamily, task: Task, capacity: int) -> "Experience":
        """A fresh environment and an empty replay."""
        action = jnp.zeros((family.actions,)) if family.continuous else jnp.zeros((), jnp.int32)
        obs = jnp.zeros(family.observation_shape)
        example = Transition(obs, action, jnp.zeros(()), jnp.zeros(()), obs)
        return cls(family.reset(key, _alone(task)), Replay.empty(example, capacity))

    def extend(self, key: Key, family: AbstractFamily, task: Task, policy: Policy, steps: int) -> "Experience":
        """Acts for ``steps`` steps and remembers them."""
        running, transitions = family.collect(key, _alone(task), self.running, policy, steps)
        return Experience(running, self.replay.add(jax.tree.map(lambda leaf: leaf[0], transitions)))


def greedy_return(key: Key, family: AbstractFamily, task: Task, policy: Policy, episodes: int) -> Scalar:
    """The mean raw return of fresh episodes on one task; never shaped."""
    copies = jax.tree.map(lambda leaf: jnp.repeat(leaf[None], episodes, axis=0), task)
    return jnp.mean(family.returns(key, copies, policy))


def _alone(task: Task) -> Task:
    """One task as a batch of one."""
    return jax.tree.map(lambda leaf: leaf[None], task)
