"""What everything that learns has in common: a pair of pure functions over immutable PyTrees."""

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
    """Algorithm 1, Algorithm 2, MAML, DQN, DDPG: each is one of these, and one loop runs them all.

    A learner is a PyTree: tasks, potentials and step sizes are its array leaves, so that learners stack along a batch
    axis and share one compiled program. Everything that changes while learning is in the state.
    """

    @property
    @abstractmethod
    def engine(self) -> str:
        """The name of the engine that runs it: "compiled" or "host"."""

    @property
    @abstractmethod
    def takes_turns(self) -> bool:
        """Whether the learners of one device take their steps of a chunk one after the other, not side by side."""

    @abstractmethod
    def init(self, key: Key) -> Any:
        """The state before the first step."""

    @abstractmethod
    def step(self, state: Any) -> tuple[Any, Metrics]:
        """One update, as the figures count them.

        A metric that is not finite stops a run, and its name tells where trouble began: metrics named after
        ``observation``, ``reward``, ``loss`` and ``gradient`` are looked at in this order.
        """

    def most_devices(self, devices: int) -> int:
        """How many of so many devices are to share the work of one learner."""
        del devices
        return 1

    def over(self, axis: str) -> "AbstractLearner":
        """This learner as one of the devices along an axis of a mesh runs it, which share its work and its state."""
        del axis
        return self

    @abstractmethod
    def report(self, state: Any) -> dict[str, Any]:
        """What is recorded between chunks of steps: at least ``return``, the raw greedy return. Changes no state."""


class AbstractTaskLearner(AbstractLearner):
    """A learner that gathers experience from the tasks of a family.

    Its step falls into two phases: only the first touches environments, and only the second computes gradients. With
    a compiled family both stand in one program; with a host family the first runs on the host, the second is compiled.

    Attributes:
        family: of the tasks.
    """

    family: eqx.AbstractVar[AbstractFamily]

    @property
    def engine(self) -> str:
        return self.family.engine

    @property
    def takes_turns(self) -> bool:
        # On CPUs the patches of convolutional learners side by side fall out of the caches, and an update costs 1.4
        # times as much. Small networks want the opposite.
        return torso_class(self.family.observation_shape).takes_turns and jax.default_backend() == "cpu"

    @abstractmethod
    def gather(self, state: Any) -> Any:
        """The experience of one step."""

    def gather_ahead(self, state: Any) -> Callable[[], Any] | None:
        """What gathers the *next* step's experience, if that needs nothing of this step's update; else None.

        Host environments then take their steps while gradients are computed. It is called when the update has begun,
        which consumes the state, so it keeps copies of what it needs.
        """
        del state
        return None

    @abstractmethod
    def update(self, state: Any, gathered: Any) -> tuple[Any, Metrics]:
        """What is learned from it: a pure function that JAX can trace."""

    def step(self, state: Any) -> tuple[Any, Metrics]:
        return self.update(state, self.gather(state))


def vital_signs(seen: Transition) -> Metrics:
    """Metrics of what an environment showed, means over the last axis of the steps ``[..., steps]``.

    The size of the observations' numbers, the successors' among them, and the raw reward.
    """
    axes = tuple(range(seen.reward.ndim - 1, seen.obs.ndim))
    sizes = jnp.abs(seen.obs) + jnp.abs(seen.next_obs)
    return {"observation_size": jnp.mean(sizes, axis=axes) / 2, "reward": jnp.mean(seen.reward, axis=-1)}
