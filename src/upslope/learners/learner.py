"""The interface of all learners: pure functions over immutable PyTrees."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.networks.torsos import torso_class
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Metrics, Transition


class AbstractLearner(eqx.Module):
    """The base class of Algorithm 1, Algorithm 2, MAML, DQN and DDPG. One loop runs all of them.

    A learner is a PyTree: tasks, potentials and step sizes are its array leaves, so that learners stack along a batch
    axis and share one compiled program. Everything that changes during learning is in the state.
    """

    @property
    @abstractmethod
    def engine(self) -> str:
        """The name of the engine that runs the learner: "compiled" or "host"."""

    @property
    @abstractmethod
    def takes_turns(self) -> bool:
        """Whether learners on one device run a chunk of steps one after the other instead of in a batch."""

    @abstractmethod
    def init(self, key: Key) -> Any:
        """The state before the first step."""

    @abstractmethod
    def step(self, state: Any) -> tuple[Any, Metrics]:
        """One update, the unit of the figures' horizontal axes.

        A metric that is not finite stops a run, and its name shows where the problem began: metrics named after
        ``observation``, ``reward``, ``loss`` and ``gradient`` are checked in this order.
        """

    def most_devices(self, devices: int) -> int:
        """How many of ``devices`` devices share the work of one learner."""
        del devices
        return 1

    def over(self, axis: str) -> "AbstractLearner":
        """The learner for one of the devices along an axis of a mesh, which share its work and its state."""
        del axis
        return self

    @abstractmethod
    def report(self, state: Any) -> dict[str, Any]:
        """Results to record between chunks of steps: at least ``return``, the raw greedy return. Changes no state."""


class AbstractTaskLearner(AbstractLearner):
    """A learner that gathers experience from the tasks of a family.

    A step has two phases: only the first uses environments, and only the second computes gradients. With a compiled
    family both phases are in one program; with a host family the first runs on the host and the second is compiled.

    Attributes:
        family: of the tasks.
    """

    family: eqx.AbstractVar[AbstractFamily]

    @property
    def engine(self) -> str:
        return self.family.engine

    @property
    def takes_turns(self) -> bool:
        # On CPUs the patches of a batch of convolutional learners exceed the caches, and an update takes 1.4 times as
        # long. Small networks are faster in a batch.
        return torso_class(self.family.observation_shape).takes_turns and jax.default_backend() == "cpu"

    @abstractmethod
    def gather(self, state: Any) -> Any:
        """The experience of one step."""

    def gather_ahead(self, state: Any) -> Callable[[], Any] | None:
        """A function that gathers the *next* step's experience, if this does not depend on this step's update; or None.

        Host environments then take their steps while gradients are computed. The function is called after the update
        has begun, which consumes the state, so the function keeps copies of what it needs.
        """
        del state
        return None

    @abstractmethod
    def update(self, state: Any, gathered: Any) -> tuple[Any, Metrics]:
        """The state after learning from the experience, and metrics: a pure function that JAX can trace."""

    def step(self, state: Any) -> tuple[Any, Metrics]:
        return self.update(state, self.gather(state))


def vital_signs(seen: Transition) -> Metrics:
    """Metrics of transitions ``[..., steps]``, as means over the last axis.

    They are the mean absolute value of the observations (including successors) and the raw reward.
    """
    axes = tuple(range(seen.reward.ndim - 1, seen.obs.ndim))
    sizes = jnp.abs(seen.obs) + jnp.abs(seen.next_obs)
    return {"observation_size": jnp.mean(sizes, axis=axes) / 2, "reward": jnp.mean(seen.reward, axis=-1)}
