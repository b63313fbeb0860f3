"""Small host environments for families, and the CartPoles on the host. Needs no JAX."""

import gymnasium as gym
import numpy as np


def length(rng):
    """A pole of any length, with the distribution of the compiled family."""
    return float(rng.uniform(0.25, 5.0))


def pole(length):
    return gym.make("upslope/CartPole-v0", length=length)


def pushed_pole(length):
    return gym.make("upslope/ContinuousCartPole-v0", length=length)


def short_pole(length):
    return gym.make("upslope/CartPole-v0", length=length, max_episode_steps=12)


SCALE = (1 / 2.4, 1 / 2.0, 1 / 0.2, 1 / 2.0)


class Lamp(gym.Env):
    """Observes samples of the given space; ends after three steps. The task is the reward of every step."""

    def __init__(self, task, observation_space, action_space=None):
        self.task, self.observation_space = task, observation_space
        self.action_space = action_space or gym.spaces.Discrete(3)
        self.seen = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.observation_space.seed(seed)
        self.time = 0
        return self.observation_space.sample(), {}

    def step(self, action):
        self.time += 1
        self.seen.append(action)
        assert self.action_space.contains(action), action
        return self.observation_space.sample(), float(self.task), self.time == 3, False, {}


class Growing(Lamp):
    """An observation that changes its shape midway."""

    def step(self, action):
        obs, *rest = super().step(action)
        return (np.append(obs, 0.0), *rest) if self.time == 2 else (obs, *rest)


class Dying(Lamp):
    """Its process exits."""

    def step(self, action):
        import os

        os._exit(1)


class OldStyle(Lamp):
    """The protocol of older meta-learning environments, drawing with numpy's global generator."""

    def __init__(self, task=1.0):
        super().__init__(task, gym.spaces.Box(-1, 1, (2,), np.float32))

    def sample_tasks(self, count):
        return list(np.random.uniform(1.0, 2.0, count))  # noqa: NPY002

    def set_task(self, task):
        self.task = task


class Unseeded(OldStyle):
    rng = np.random.default_rng()

    def sample_tasks(self, count):
        return list(self.rng.uniform(size=count))


def vectors(*shape):
    return gym.spaces.Box(-1, 1, shape or (2,), np.float32)
