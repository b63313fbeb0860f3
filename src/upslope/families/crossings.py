"""Rooms with a wall to cross, as small images: MiniGrid's SimpleCrossing, a new room for every seed."""

from typing import Any

import gymnasium as gym
import numpy as np

from upslope.families.extras import minigrid
from upslope.tasks.gymnasium_tasks import GymnasiumTasks


class Crossing(gym.Wrapper):
    """The whole room as an image, in the room of one seed; actions turn left, turn right and go forward."""

    def __init__(self, env: gym.Env, room: int):
        super().__init__(minigrid().wrappers.ImgObsWrapper(minigrid().wrappers.FullyObsWrapper(env)))
        self.action_space = gym.spaces.Discrete(3)
        self.room = room

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict]:
        del seed  # it would draw another room
        return self.env.reset(seed=self.room, options=options)


def sample(rng: np.random.Generator) -> int:
    """The seed of a room."""
    return int(rng.integers(2**31))


def crossings(size: int = 9, walls: int = 1, gamma: float = 0.98, mode: str = "sync") -> GymnasiumTasks:
    """Reward 1 at the goal, less 0.9 times the share of the time that it took.

    Args:
        size: rows and columns: 9 or 11.
        walls: the number of walls: 1 to 3 for 9, 5 for 11.
        gamma: γ.
        mode: where environments run, see `GymnasiumTasks`.
    """
    gym.register_envs(minigrid())
    name = f"MiniGrid-SimpleCrossingS{size}N{walls}-v0"

    def set_task(env: gym.Env, task: int) -> None:
        env.room = task  # type: ignore[attr-defined]

    return GymnasiumTasks(
        sample,
        lambda task: Crossing(gym.make(name), task),
        gamma,
        name=f"crossing-{size}-{walls}",
        max_steps=4 * size * size,
        set_task=set_task,
        mode=mode,
    )
