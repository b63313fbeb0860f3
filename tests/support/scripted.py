"""Environments that play back a script, so that every observation, end and reward is known. Needs no JAX."""

from typing import NamedTuple

import gymnasium as gym
import numpy as np


class Step(NamedTuple):
    """The outcome of one step. The level is the first coordinate of the observation, and Φ of `level` below."""

    level: float
    reward: float = 1.0
    terminated: bool = False
    truncated: bool = False


def level(obs):
    """Φ(s) is the first coordinate."""
    return obs[0]


class Scripted(gym.Env):
    """Plays episodes in turn: each begins at a level and then takes its steps, whatever the actions."""

    observation_space = gym.spaces.Box(-1e3, 1e3, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, *episodes):
        self.episodes = episodes
        self.at = -1

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = (self.at + 1) % len(self.episodes)
        self.start, self.steps = self.episodes[self.at]
        self.time = 0
        return self._obs(self.start), {}

    def step(self, action):
        step = self.steps[self.time]
        self.time += 1
        return self._obs(step.level), step.reward, step.terminated, step.truncated, {"seen": self.time}

    def _obs(self, value):
        return np.array([value, 99.0], np.float32)


#: Φ: 2, 5 (ordinary), then truncated at 7; then from −1 to 3 (terminated); then from 4 to 6 (both at once).
EPISODES = (
    (2.0, [Step(5.0, 0.5), Step(7.0, 2.0, truncated=True)]),
    (-1.0, [Step(3.0, -1.0, terminated=True)]),
    (4.0, [Step(6.0, 0.0, terminated=True, truncated=True)]),
)
GAMMA = 0.9
#: F of each of these steps, by hand.
F = (0.9 * 5 - 2, 0.9 * 7 - 5, 1.0, -4.0)
RAW = (0.5, 2.0, -1.0, 0.0)


class Walk(gym.Env):
    """A random walk that terminates, is truncated, or both, at random steps."""

    observation_space = gym.spaces.Box(-1e3, 1e3, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.normal(size=2)
        return self.place.astype(np.float32), {}

    def step(self, action):
        self.place = self.place + self.np_random.normal(size=2) + (0.1 if action else -0.1)
        ends = self.np_random.random(2) < 0.15
        return self.place.astype(np.float32), float(self.np_random.normal()), bool(ends[0]), bool(ends[1]), {}
