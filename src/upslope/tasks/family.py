"""The interface of a family of tasks p(T): it samples tasks and collects experience from them."""

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

    Learners get tasks and experience from it, in batches with a leading axis of tasks ``[n, ...]``. Whether the
    environments run compiled or on the host is up to the family.

    Attributes:
        name: of the state space. A prior belongs to a name. A family and its version with continuous actions share it.
        gamma: γ of every task; it is stored only here.
        observation_shape: of one observation.
        observation_scale: factors that scale observations to the order of one.
        actions: their kind and number.
        max_steps: the longest episode.
        recipe: the name of suitable settings of meta-training and of learners.
        lists_states: whether all states of a task can be listed, as tables and exact planning require.
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
        """``observe_all(task)``, the observations of all states, and ``state_number(obs)``, an index into them.

        Raises:
            UpslopeError: states can't be listed.
        """

    @abstractmethod
    def sample(self, key: Key | int) -> Task:
        """Draws one task.

        Args:
            key: a JAX key, or an integer seed for one.

        Raises:
            UpslopeError: the key is neither of these.
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
        """`reset`, then `collect`, then discards the environments. Returns transitions ``[n, steps, ...]``."""

    def rollout_later(self, key: Key, tasks: Task, policy: Policy, steps: int) -> Callable[[], Transition]:
        """`rollout` in two parts: random numbers are drawn now; the environments run when the result is called."""
        return lambda: self.rollout(key, tasks, policy, steps)

    @abstractmethod
    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        """The raw, undiscounted return of one fresh episode on each of ``n`` stacked tasks."""

    @abstractmethod
    def acting_network(self, newest: Network, previous: Network) -> Network:
        """The network that collects the next experience: the previous one if collection overlaps with the update.

        Args:
            newest: after the update.
            previous: before it.
        """

    def task_of(self, task: Task) -> Any:
        """The task as its sampler returned it."""
        return task

    def sample_many(self, key: Key, count: int) -> Task:
        """Draws ``count`` tasks as one stacked PyTree ``[count, ...]``."""
        return jax.vmap(self.sample)(jax.random.split(key, count))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.name!r}, gamma={self.gamma}, observations {list(self.observation_shape)}, "
            f"{self.actions.count} {self.actions.kind} actions, {self.max_steps} steps)"
        )


def as_key(key: Any) -> Key:
    """A JAX key, from a JAX key or from an integer.

    Raises:
        UpslopeError: it is neither of these.
    """
    if isinstance(key, int | np.integer):
        return jax.random.key(key)
    if not isinstance(key, jax.Array):
        raise UpslopeError(f"A task is drawn with jax.random.key(seed) or an integer, but {key!r:.60} was given.")
    return key


def recipe_of(observation_shape: tuple[int, ...]) -> str:
    """The recipe for an observation shape: "images" for ``(height, width, channels)``, "vectors" for ``(n,)``."""
    return {1: "vectors", 3: "images"}[len(observation_shape)]
