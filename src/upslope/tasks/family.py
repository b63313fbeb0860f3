"""What a family of tasks p(T) is: a sampler of tasks that knows how to collect experience from them."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Literal, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from upslope.errors import UpslopeError
from upslope.tasks.actions import Actions
from upslope.types import Key, Policy, Task, Transition

Network = TypeVar("Network")


class AbstractFamily(eqx.Module):
    """A distribution over tasks that share a state space.

    Learners ask it for tasks and for experience, in batches with a leading axis of tasks ``[n, ...]``;
    how the environments run, compiled or on the host, is its own affair.

    Attributes:
        name: of the state space. A prior is for a name; the continuous twin of a family shares it.
        gamma: γ of every task, written nowhere else.
        observation_shape: of one observation.
        observation_scale: brings each observation to the order of one.
        actions: their kind and number.
        max_steps: the longest episode.
        recipe: the name of the settings that suit the family, of meta-training and of learners.
        lists_states: whether all states of a task can be listed, so that tables and exact planning fit it.
        engine: how experience is collected: "compiled" into the learner's own program, or on the "host", in Python.
    """

    engine: eqx.AbstractClassVar[Literal["compiled", "host"]]

    name: eqx.AbstractVar[str]
    gamma: eqx.AbstractVar[float]
    observation_shape: eqx.AbstractVar[tuple[int, ...]]
    observation_scale: eqx.AbstractVar[tuple[float, ...]]
    actions: eqx.AbstractVar[Actions]
    max_steps: eqx.AbstractVar[int]
    recipe: eqx.AbstractVar[str]

    @property
    @abstractmethod
    def lists_states(self) -> bool: ...

    @property
    @abstractmethod
    def states(self) -> Any:
        """``observe_all(task)``, the observation of every state, and ``state_number(obs)``, its place there.

        Raises:
            UpslopeError: states can't be listed.
        """

    @abstractmethod
    def sample(self, key: Key | int) -> Task:
        """Draws one task.

        Args:
            key: a key of JAX, or an integer to make one from.

        Raises:
            UpslopeError: something else.
        """

    @abstractmethod
    def reset(self, key: Key, tasks: Task) -> Any:
        """Starts one environment for each of ``n`` stacked tasks; returns the running environments."""

    @abstractmethod
    def collect(self, key: Key, tasks: Task, running: Any, policy: Policy, steps: int) -> tuple[Any, Transition]:
        """Takes ``steps`` steps in each environment, with automatic reset.

        Returns:
            The running environments, and transitions ``[n, steps, ...]`` with raw rewards and true successors.
        """

    @abstractmethod
    def rollout(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Transition:
        """`reset`, then `collect`, then the environments are given up: transitions ``[n, steps, ...]``."""

    def rollout_later(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Callable[[], Transition]:
        """The same `rollout` in two parts: what is drawn is drawn now, and the environments run when it is called."""
        return lambda: self.rollout(key, tasks, policy, steps)

    @abstractmethod
    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        """The raw, undiscounted return of one fresh episode on each of ``n`` stacked tasks."""

    @abstractmethod
    def acting_network(self, newest: Network, previous: Network) -> Network:
        """Which network collects the next experience, after an update: where it is collected meanwhile, the one before.

        Args:
            newest: after the update.
            previous: before it.
        """

    def sample_many(self, key: Key, count: int) -> Task:
        """Draws ``count`` tasks as one stacked PyTree ``[count, ...]``."""
        return jax.vmap(self.sample)(jax.random.split(key, count))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.name!r}, gamma={self.gamma}, observations {list(self.observation_shape)}, "
            f"{self.actions.count} {self.actions.kind} actions, {self.max_steps} steps)"
        )


def as_key(key: Any) -> Key:
    """A key of JAX, from such a key or from an integer.

    Raises:
        UpslopeError: something else.
    """
    if isinstance(key, int | np.integer):
        return jax.random.key(key)
    if not isinstance(key, jax.Array):
        raise UpslopeError(f"A task is drawn with jax.random.key(seed) or an integer, but {key!r:.60} was given.")
    return key


def recipe_of(observation_shape: tuple[int, ...]) -> str:
    """The recipe for observations of a shape: that of "images" ``(height, width, channels)``, or of "vectors"."""
    return {1: "vectors", 3: "images"}[len(observation_shape)]
