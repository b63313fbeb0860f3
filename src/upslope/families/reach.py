"""A point mass on a line, which stops at a goal on one side or the other: a small family with a sparse reward."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from upslope.tasks.gymnasium_tasks import GymnasiumTasks


class ReachTask(NamedTuple):
    """Where the goal is, and how heavy the mass."""

    goal: float
    mass: float


class Reach(gym.Env):
    """Observations are position, velocity and goal; actions push left, not at all, or right.

    Reward 1 within 0.1 of the goal at a speed below 0.3, which ends the episode, as does leaving [−2, 2] without one.
    """

    observation_space = gym.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gym.spaces.Discrete(3)

    def __init__(self, task: ReachTask):
        self.task = task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self._place, self._speed = self.np_random.uniform(-0.1, 0.1), 0.0
        return self._observe(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict]:
        push = 0.05 * (int(action) - 1) / self.task.mass
        self._speed = 0.98 * (self._speed + push)
        self._place += 0.1 * self._speed
        arrived = abs(self._place - self.task.goal) < 0.1 and abs(self._speed) < 0.3
        return self._observe(), float(arrived), arrived or abs(self._place) > 2.0, False, {}

    def _observe(self) -> np.ndarray:
        return np.array([self._place, self._speed, self.task.goal], np.float32)


def sample(rng: np.random.Generator) -> ReachTask:
    """Goals 0.5 to 1.5 from the middle, on both sides equally often."""
    return ReachTask(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)), float(rng.uniform(0.5, 2.0)))


def reach(gamma: float = 0.98) -> GymnasiumTasks:
    """The family; 100 steps are truncation."""
    return GymnasiumTasks(
        sample, lambda task: gym.wrappers.TimeLimit(Reach(task), 100), gamma, name="reach", max_steps=100
    )
