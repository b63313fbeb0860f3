"""One task as a family of its own: what an oracle is trained on."""

from typing import Any

from jaxtyping import Array, Float

from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Policy, Task, Transition


class SingleTask(AbstractFamily):
    """The family that always draws the same task; all else as in the family that the task came from.

    Attributes:
        family: where the task came from.
        task: the task; an array leaf, so that many of these stack and share one compiled program.
    """

    family: AbstractFamily
    task: Task

    @property
    def name(self) -> str:
        return self.family.name

    @property
    def gamma(self) -> float:
        return self.family.gamma

    @property
    def observation_shape(self) -> tuple[int, ...]:
        return self.family.observation_shape

    @property
    def observation_scale(self) -> tuple[float, ...]:
        return self.family.observation_scale

    @property
    def actions(self) -> int:
        return self.family.actions

    @property
    def continuous(self) -> bool:
        return self.family.continuous

    @property
    def max_steps(self) -> int:
        return self.family.max_steps

    def sample(self, key: Key) -> Task:
        del key
        return self.task

    def reset(self, key: Key, tasks: Task) -> Any:
        return self.family.reset(key, tasks)

    def collect(
        self, key: Key, tasks: Task, running: Any, policy: Policy, steps: int
    ) -> tuple[Any, Transition]:
        return self.family.collect(key, tasks, running, policy, steps)

    def returns(self, key: Key, tasks: Task, policy: Policy) -> Float[Array, "n"]:
        return self.family.returns(key, tasks, policy)
