"""What the settings of a learner of one task have in common: they name the learner and build it."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from upslope.errors import UpslopeError
from upslope.learners.learner import AbstractTaskLearner
from upslope.learners.shaping import Shaping
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Task


class AbstractLearnerConfig(ABC):
    """Settings of a learner. A new learner is one file with such a class, and one line in `upslope.learners`.

    Subclasses are frozen dataclasses whose fields JSON can hold.

    Attributes:
        name: on the command line, in log folders and in files of agents.
        actions: the kind of action that it needs, "discrete" or "continuous".
    """

    name: ClassVar[str]
    actions: ClassVar[str]

    @classmethod
    @abstractmethod
    def for_recipe(cls, recipe: str) -> "AbstractLearnerConfig":
        """The settings that suit families with this ``recipe``."""

    @abstractmethod
    def build(self, family: AbstractFamily, task: Task, shaping: Shaping | None) -> AbstractTaskLearner:
        """The learner of one task, its rewards shaped where a shaping is given.

        Raises:
            UpslopeError: the family has another kind of action.
        """

    @abstractmethod
    def policy_network(
        self, key: Key, observation_shape: tuple[int, ...], actions: int, observation_scale: tuple[float, ...]
    ) -> Any:
        """A network with random weights that acts: it has ``best(obs)`` and ``numpy_best()``."""

    @abstractmethod
    def acting(self, state: Any) -> Any:
        """The network that acts, of a state of the learner."""

    def check_actions(self, family: AbstractFamily) -> None:
        """Whether the family has the kind of action that the learner needs.

        Raises:
            UpslopeError: it has another.
        """
        kind = family.actions.kind
        if kind != self.actions:
            raise UpslopeError(
                f"{self.name.upper()} needs {self.actions} actions, but the tasks of {family.name!r} have {kind} ones: "
                f"choose a learner for {kind} actions, or tasks with {self.actions} ones."
            )
