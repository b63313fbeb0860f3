"""What Algorithm 1 asks of a task-posterior: how it draws from a replay, adapts to it, and how far it is from θ."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from tyro.conf import Fixed, Suppress

from upslope.learners.policies import AbstractPolicy
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso
from upslope.tasks.family import AbstractFamily
from upslope.types import Keys, Metrics, Policy, Scalar, Task, Transition

#: D_i of every task, and what one outer step draws from them: PyTrees ``[tasks, ...]`` of the posterior's own making.
Replays = Any
Samples = Any

#: Makes a policy that explores around a network's best actions, from ε of each environment.
Explorer = Callable[[Any, Float[Array, "n"]], AbstractPolicy]

#: A name that belongs to the class: files hold it, and the command line does not show it as an option.
Name = Suppress[Fixed[str]]


@dataclass(frozen=True)
class AbstractPosterior(ABC):
    """The settings of φ_i, and what Algorithm 1 asks of it.

    Attributes:
        name: in settings and on the command line.
        environments: of each task, side by side.
    """

    name: Name = field(init=False)

    @property
    @abstractmethod
    def environments(self) -> int: ...

    @abstractmethod
    def check(self, family: AbstractFamily) -> None:
        """Whether this posterior fits a family.

        Raises:
            UpslopeError: it doesn't.
        """

    @abstractmethod
    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        """Whether tasks are adapted to one after the other, not side by side, for networks with such a torso."""

    @abstractmethod
    def policy(
        self, theta: DuelingQ, family: AbstractFamily, tasks: Task, epsilon: tuple[float, float], explorer: Explorer
    ) -> Policy:
        """Acts ε-greedily by Q_θ in all environments of all tasks.

        Args:
            theta: θ.
            family: of the tasks.
            tasks: ``[tasks, ...]``.
            epsilon: ε runs from the first number to the second.
            explorer: explores around the best actions.
        """

    @abstractmethod
    def replays(self, family: AbstractFamily, tasks: Task, transitions: Transition) -> Replays:
        """D_i of every task ``[tasks, ...]``, from transitions ``[tasks · environments, steps, ...]``."""

    @abstractmethod
    def vital_signs(self, replays: Replays) -> Metrics:
        """Metrics of what the environments showed, one number for each task: the first to tell where trouble began."""

    @abstractmethod
    def draw(self, keys: Keys, replays: Replays, target: DuelingQ) -> Samples:
        """The samples of every task ``[tasks, ...]`` for one outer step; inner and outer loss use the same.

        Args:
            keys: one for each task.
            replays: D_i.
            target: the averaged network of the inner TD target.
        """

    @abstractmethod
    def adapt(self, theta: DuelingQ, samples: Samples) -> Any:
        """φ_i: Eq. 2, N times, on the TD error of Eq. 5, for one task."""

    @abstractmethod
    def distance(self, theta: DuelingQ, phi: Any, samples: Samples) -> Scalar:
        """Eq. 7: how far Q_θ is from Q_φ, for one task."""

    def moved_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        """The network of the inner TD target after an outer step that ended at θ; it need not move before the last."""
        del theta
        return target

    @abstractmethod
    def next_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        """The network of the inner TD target after an iteration that ended at θ."""


def spaced(epsilon: tuple[float, float], count: int) -> Float[Array, "count"]:
    """Shares of random actions, evenly spaced from the first to the second."""
    return jnp.linspace(*epsilon, count)


def repeat_tasks(tasks: Task, times: int) -> Task:
    """Each task ``times`` times in a row ``[tasks · times, ...]``."""
    return jax.tree.map(lambda leaf: jnp.repeat(leaf, times, axis=0), tasks)
