"""The interface of the settings of learners of one task: they name the learner and build it."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from upslope.errors import UpslopeError
from upslope.learners.learner import AbstractTaskLearner
from upslope.learners.shaping import Shaping
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Task


class AbstractLearnerConfig(ABC):
    """Settings of a learner. A new learner is one file with such a class and one line in `upslope.learners`.

    Subclasses are frozen dataclasses with fields that can be stored as JSON.

    Attributes:
        name: the learner's name on the command line, in log folders and in agent files.
        actions: the kind of action that the learner needs, "discrete" or "continuous".
    """

    name: ClassVar[str]
    actions: ClassVar[str]

    @classmethod
    @abstractmethod
    def for_recipe(cls, recipe: str) -> "AbstractLearnerConfig":
        """The settings that suit families with this ``recipe``."""

    @abstractmethod
    def lasting(self, updates: int) -> "AbstractLearnerConfig":
        """The same settings for a training of so many updates: the step size does not fall to zero before its end."""

    @abstractmethod
    def build(self, family: AbstractFamily, task: Task, shaping: Shaping | None) -> AbstractTaskLearner:
        """The learner of one task, with shaped rewards if a shaping is given.

        Raises:
            UpslopeError: the family has another kind of action.
        """

    @abstractmethod
    def policy_network(
        self, key: Key, observation_shape: tuple[int, ...], actions: int, observation_scale: tuple[float, ...]
    ) -> Any:
        """A policy network with random weights: it has ``best(obs)`` and ``numpy_best()``."""

    @abstractmethod
    def acting(self, state: Any) -> Any:
        """The network that acts, from a state of the learner."""

    def check_actions(self, family: AbstractFamily) -> None:
        """Checks that the family has the kind of action that the learner needs.

        Raises:
            UpslopeError: it has another kind.
        """
        kind = family.actions.kind
        if kind != self.actions:
            raise UpslopeError(
                f"{self.name.upper()} needs {self.actions} actions, but the tasks of {family.name!r} have {kind} ones: "
                f"choose a learner for {kind} actions, or tasks with {self.actions} ones."
            )
