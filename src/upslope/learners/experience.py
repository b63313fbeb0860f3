"""A learner's experience of one task: a running environment, and a replay with raw rewards."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.learners.lookups import policy_with_table
from upslope.learners.policies import AbstractPolicy
from upslope.learners.replay import Replay
from upslope.learners.shaping import Shaping
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Policy, Scalar, Task, Transition


class Record(NamedTuple):
    """The record of one step: the raw transition and, separately, F of a fixed potential.

    F is computed once, when the step is taken, and not whenever the record is drawn. For a potential that changes, no F
    is stored (``None``): a whole batch must be shaped by the same version of Φ.
    """

    transition: Transition
    added: Float[Array, "*batch"] | None


class Experience(eqx.Module):
    """One environment of one task, and the records of its steps."""

    running: Any
    replay: Replay

    @classmethod
    def start(
        cls, key: Key, family: AbstractFamily, task: Task, capacity: int, shaping: Shaping | None = None
    ) -> "Experience":
        """A fresh environment and an empty replay."""
        obs = jnp.zeros(family.observation_shape)
        example = Transition(obs, family.actions.zeros(xp=jnp), jnp.zeros(()), jnp.zeros(()), obs)
        record = Record(example, None if shaping is None else jnp.zeros(()))
        return cls(family.reset(key, _alone(task)), Replay.empty(record, capacity))

    def act(
        self, key: Key, family: AbstractFamily, task: Task, policy: AbstractPolicy, steps: int
    ) -> tuple[Any, Transition]:
        """Takes ``steps`` steps. Returns the running environment and the raw transitions ``[steps, ...]``."""
        policy = policy_with_table(family, task, policy, steps)
        running, transitions = family.collect(key, _alone(task), self.running, policy, steps)
        return running, jax.tree.map(lambda leaf: leaf[0], transitions)

    def remember(self, running: Any, transitions: Transition, shaping: Shaping | None = None) -> "Experience":
        """Adds the results of `act` to the replay, with F next to the raw rewards if there is a shaping."""
        record = Record(transitions, None if shaping is None else shaping.rewards(transitions))
        return Experience(running, self.replay.add(record))

    def extend(
        self,
        key: Key,
        family: AbstractFamily,
        task: Task,
        policy: AbstractPolicy,
        steps: int,
        shaping: Shaping | None = None,
    ) -> tuple["Experience", Transition]:
        """`act`, then `remember`. Returns the new experience and the new raw transitions ``[steps, ...]``."""
        running, transitions = self.act(key, family, task, policy, steps)
        return self.remember(running, transitions, shaping), transitions

    def sample(self, key: Key, count: int) -> Record:
        """Draws ``count`` records uniformly."""
        return self.replay.sample(key, count)


def greedy_return(key: Key, family: AbstractFamily, task: Task, policy: Policy, episodes: int) -> Scalar:
    """The mean raw return of fresh episodes on one task, without shaping."""
    copies = jax.tree.map(lambda leaf: jnp.repeat(leaf[None], episodes, axis=0), task)
    return jnp.mean(family.returns(key, copies, policy))


def _alone(task: Task) -> Task:
    """One task as a batch of one."""
    return jax.tree.map(lambda leaf: leaf[None], task)
