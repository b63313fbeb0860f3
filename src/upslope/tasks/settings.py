"""Settings of the families on the command line, and of the choice of a task from each of them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from upslope.errors import UpslopeError
from upslope.tasks.cartpoles import cartpoles
from upslope.tasks.family import AbstractFamily
from upslope.tasks.grid_maps import Split
from upslope.tasks.grids import clean_maps, grid_games, obstacle_maps
from upslope.types import Task


class AbstractTaskChoice(ABC):
    """Settings that choose one task of a family. Subclasses are frozen dataclasses."""

    @abstractmethod
    def task(self, family: AbstractFamily, seed: int) -> tuple[Task, str]:
        """The task, and a description for titles.

        Raises:
            UpslopeError: the settings are not valid for a task.
        """


@dataclass(frozen=True)
class RandomTask(AbstractTaskChoice):
    """The task that the seed draws."""

    def task(self, family: AbstractFamily, seed: int) -> tuple[Task, str]:
        return draw_task(family, seed), f"{family.name} task {seed}"


@dataclass(frozen=True)
class PoleChoice(AbstractTaskChoice):
    """Chooses a CartPole by the length of its pole.

    Attributes:
        pole: length of the pole in metres; drawn from the family by default.
    """

    pole: float | None = None

    def task(self, family: AbstractFamily, seed: int) -> tuple[Task, str]:
        task = draw_task(family, seed)
        if self.pole is not None:
            if not (np.isfinite(self.pole) and self.pole > 0):
                raise UpslopeError(f"The pole can't be {self.pole} m long: give a positive length.")
            task = replace(task, length=jnp.asarray(self.pole, jnp.float32))
        return task, f"a pole of {float(task.length):.2f} m"


def draw_task(family: AbstractFamily, seed: int) -> Task:
    """The task of a family for a seed."""
    return family.sample(jax.random.fold_in(jax.random.key(seed), 1))


class AbstractFamilySettings(ABC):
    """Settings of a family. Subclasses are frozen dataclasses. Their fields are the options on the command line.

    Attributes:
        recipe: the recipe of the family.
        task_choice: the settings that choose one of its tasks.
    """

    recipe: ClassVar[str]
    task_choice: ClassVar[type[AbstractTaskChoice]]

    @abstractmethod
    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        """The family.

        Args:
            split: for maps; "train" and "test" share no map.
            actions: the kind of action; families that have only one kind ignore it.

        Raises:
            UpslopeError: the settings are not valid for a family.
        """


@dataclass(frozen=True)
class CartPoles(AbstractFamilySettings):
    """CartPoles with poles of varied length (Sec. 5.1).

    Attributes:
        length: shortest and longest pole, in metres.
        half_length: the lengths are half the pole's length, as in Gymnasium.
        track_limit: end of the track, in metres from its middle.
        gamma: discount of the tasks and of the potential.
    """

    recipe: ClassVar[str] = "poles"
    task_choice: ClassVar[type[AbstractTaskChoice]] = PoleChoice

    length: tuple[float, float] = (0.25, 5.0)
    half_length: bool = False
    track_limit: float = 2.4
    gamma: float = 0.98

    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        del split  # pole lengths are drawn from an interval
        return cartpoles(
            self.length,
            continuous=actions == "continuous",
            half_length=self.half_length,
            gamma=self.gamma,
            track_limit=self.track_limit,
        )


@dataclass(frozen=True)
class ObstacleMaps(AbstractFamilySettings):
    """The paper's 8 × 8 maps with obstacles (Sec. 5.2).

    Attributes:
        gamma: discount of the tasks and of the potential.
    """

    recipe: ClassVar[str] = "maps"
    task_choice: ClassVar[type[AbstractTaskChoice]] = RandomTask

    gamma: float = 0.9

    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        del actions
        return obstacle_maps(split, gamma=self.gamma)


@dataclass(frozen=True)
class CleanMaps(AbstractFamilySettings):
    """The paper's 10 × 10 maps without obstacles (Sec. 5.2); test maps and training maps have different goals.

    Attributes:
        gamma: discount of the tasks and of the potential.
    """

    recipe: ClassVar[str] = "maps"
    task_choice: ClassVar[type[AbstractTaskChoice]] = RandomTask

    gamma: float = 0.9

    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        del actions
        return clean_maps(split, held_out="goals", gamma=self.gamma)


@dataclass(frozen=True)
class GridGames(AbstractFamilySettings):
    """Maps of any size, with obstacles, traps and slippery floors.

    Attributes:
        size: rows and columns.
        obstacles: probability that a cell is an obstacle.
        traps: probability that another cell is a trap.
        slip: probability that a move slips to a side.
        gamma: discount of the tasks and of the potential.
    """

    recipe: ClassVar[str] = "maps"
    task_choice: ClassVar[type[AbstractTaskChoice]] = RandomTask

    size: tuple[int, int] = (8, 8)
    obstacles: float = 0.2
    traps: float = 0.0
    slip: float = 0.0
    gamma: float = 0.9

    def build(self, split: Split = "all", *, actions: str = "discrete") -> AbstractFamily:
        del actions
        return grid_games(
            self.size, obstacles=self.obstacles, traps=self.traps, slip=self.slip, gamma=self.gamma, split=split
        )


#: Families by their names on the command line. A new family is one class and one line here.
FAMILIES: dict[str, type[AbstractFamilySettings]] = {
    "cartpole": CartPoles,
    "obstacles": ObstacleMaps,
    "clean": CleanMaps,
    "grid": GridGames,
}
