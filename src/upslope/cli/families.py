"""The families that the command line knows by name, their settings, and what is learned with there by default."""

from dataclasses import dataclass, replace
from typing import Literal

import jax
import numpy as np

from upslope.errors import UpslopeError
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import ITERATIONS, for_grid_games
from upslope.tasks import FAMILIES, JaxTasks, cartpoles, clean_maps, grid_games, obstacle_maps
from upslope.types import Task


@dataclass(frozen=True)
class Tasks:
    """Settings of a family's tasks; each family heeds those that it has."""

    length: tuple[float, float] = (0.25, 5.0)
    """Poles: shortest and longest, in metres."""
    half_length: bool = False
    """Poles: the lengths are of half the pole, as Gymnasium counts, not of the whole."""
    track_limit: float = 2.4
    """Poles: where the track ends, in metres from its middle."""
    size: tuple[int, int] = (8, 8)
    """Maps of the family grid: rows and columns."""
    obstacles: float = 0.2
    """Maps of the family grid: probability that a cell is an obstacle."""
    traps: float = 0.0
    """Maps of the family grid: probability that another cell is a trap."""
    slip: float = 0.0
    """Maps of the family grid: probability that a move slips to a side."""
    gamma: float | None = None
    """The discount of the tasks and of the potential; 0.98 for poles and 0.9 for maps by default."""

    def family(self, name: str, *, continuous: bool = False, split: Literal["train", "test"] = "test") -> JaxTasks:
        """The family of this name; of maps the split.

        Raises:
            UpslopeError: no such family, or settings that make none.
        """
        if name not in FAMILIES:
            raise UpslopeError(f"There is no family {name!r}: choose one of {', '.join(FAMILIES)}.")
        if name == "cartpole":
            return cartpoles(
                self.length,
                continuous=continuous,
                half_length=self.half_length,
                gamma=0.98 if self.gamma is None else self.gamma,
                track_limit=self.track_limit,
            )
        if continuous:
            raise UpslopeError("Maps have discrete actions: use dqn.")
        gamma = 0.9 if self.gamma is None else self.gamma
        if name == "clean":
            return clean_maps(split, held_out="goals", gamma=gamma)
        if name == "obstacles":
            return obstacle_maps(split, gamma=gamma)
        return grid_games(
            self.size, obstacles=self.obstacles, traps=self.traps, slip=self.slip, gamma=gamma, split=split
        )


def recipe_for(name: str) -> MetaTrainingConfig:
    """Algorithm 1's settings on a family; CartPole's where the name is none."""
    if name == "cartpole" or name not in FAMILIES:
        return MetaTrainingConfig()
    return for_grid_games(ITERATIONS.get(name, ITERATIONS["obstacles"]))


def draw_task(family: JaxTasks, pole: float | None, seed: int) -> tuple[Task, str]:
    """A task drawn by the seed, or a CartPole with this pole; and what to call it.

    Raises:
        UpslopeError: a pole that can't be, or that is meant for a map.
    """
    task = family.sample(jax.random.fold_in(jax.random.key(seed), 1))
    if family.name != "cartpole":
        if pole is not None:
            raise UpslopeError("Maps have no pole: leave --pole out, and choose a map by --seed.")
        return task, f"map {seed}"
    if pole is not None:
        if not (np.isfinite(pole) and pole > 0):
            raise UpslopeError(f"A pole of {pole} m can't be balanced: give a positive length.")
        task = replace(task, length=jax.numpy.asarray(pole, jax.numpy.float32))
    return task, f"a pole of {float(task.length):.2f} m"
