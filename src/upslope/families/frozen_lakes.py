"""Random frozen lakes, with and without slipping: Gymnasium's FrozenLake on maps of its own generator."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.frozen_lake import generate_random_map

from upslope.tasks.gymnasium_tasks import GymnasiumTasks


class Lake(NamedTuple):
    """Rows of a map, in the letters of FrozenLake, and whether the ice is slippery."""

    rows: tuple[str, ...]
    slippery: bool


class ObservedLake(gym.ObservationWrapper):
    """Where one stands, where the holes are, and whether it is slippery, as one vector of zeros and ones."""

    def __init__(self, lake: Lake):
        super().__init__(gym.make("FrozenLake-v1", desc=list(lake.rows), is_slippery=lake.slippery))
        holes = [letter == "H" for row in lake.rows for letter in row]
        self._map = np.array([*holes, lake.slippery], np.float32)
        self._places = np.eye(len(holes), dtype=np.float32)
        self.observation_space = gym.spaces.Box(0, 1, (2 * len(holes) + 1,), np.float32)

    def observation(self, observation: Any) -> np.ndarray:
        return np.concatenate([self._places[int(observation)], self._map])


def frozen_lakes(size: int = 5, frozen: float = 0.8, gamma: float = 0.98) -> GymnasiumTasks:
    """Reward 1 at the goal in the far corner; holes end the episode, as does success. 100 steps are truncation.

    Args:
        size: rows and columns.
        frozen: the probability that a cell is no hole.
        gamma: γ.
    """

    def sample(rng: np.random.Generator) -> Lake:
        rows = generate_random_map(size, frozen, int(rng.integers(2**31)))
        return Lake(tuple(rows), bool(rng.random() < 0.5))

    return GymnasiumTasks(sample, ObservedLake, gamma, name=f"frozen-lake-{size}", max_steps=100)
