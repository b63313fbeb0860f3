"""Typical hand-written shaping wrappers for vector environments: one correct, the others with one mistake each."""

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from support.wrong_wrappers import GAMMA, phi


class VectorRight(gym.vector.VectorWrapper):
    """A correct vector wrapper for all three modes."""

    def __init__(self, env):
        super().__init__(env)
        self.mode = env.metadata["autoreset_mode"]

    def reset(self, *, seed=None, options=None):
        mask = np.array((options or {}).get("reset_mask", np.ones(self.num_envs, bool)))
        obs, infos = self.env.reset(seed=seed, options=options)
        new = np.array([phi(one) for one in obs])
        self.last = np.where(mask, new, getattr(self, "last", new))
        self.ended = getattr(self, "ended", np.zeros(self.num_envs, bool)) & ~mask
        return obs, infos

    def step(self, actions):
        obs, rewards, terminated, truncated, infos = self.env.step(actions)
        done = terminated | truncated
        ahead = np.array([phi(one) for one in self.successors(obs, done, infos)])
        added = GAMMA * ahead * ~terminated - self.last
        added = self.at_dummies(added)
        self.last = np.array([phi(one) for one in obs])
        self.ended = done & (self.mode is AutoresetMode.NEXT_STEP)
        return obs, rewards + added, terminated, truncated, infos

    def successors(self, obs, done, infos):
        if self.mode is AutoresetMode.SAME_STEP and done.any():
            return [infos["final_obs"][i] if done[i] else obs[i] for i in range(self.num_envs)]
        return obs

    def at_dummies(self, added):
        return np.where(self.ended, 0.0, added)


class VectorResetObservation(VectorRight):
    """Same-step: the returned observation is used as the successor."""

    def successors(self, obs, done, infos):
        return obs


class VectorDummyPaid(VectorRight):
    """Next-step: the reset is shaped like a transition."""

    def at_dummies(self, added):
        return added


class Hides(gym.vector.VectorWrapper):
    """Shapes correctly, then removes the final observation from the infos."""

    def step(self, actions):
        *rest, infos = self.env.step(actions)
        infos.pop("final_obs", None)
        return (*rest, infos)


class VectorWrong(VectorRight):
    """Correct; the subclasses change one method each."""

    def step(self, actions):
        obs, rewards, terminated, truncated, infos = self.env.step(actions)
        done = terminated | truncated
        ahead = np.array([phi(one) for one in self.successors(obs, done, infos)])
        added = self.transform(self.at_dummies(self.discount(terminated, truncated) * ahead - self.last))
        self.last = np.array([phi(one) for one in obs])
        self.ended = done & (self.mode is AutoresetMode.NEXT_STEP)
        return obs, self.total(rewards, added), terminated, truncated, infos

    def discount(self, terminated, truncated):
        return GAMMA * ~terminated

    def transform(self, added):
        return added

    def total(self, rewards, added):
        return rewards + added


class VectorNeverApplied(VectorWrong):
    def total(self, rewards, added):
        return rewards


class VectorTerminalPotential(VectorWrong):
    def discount(self, terminated, truncated):
        return GAMMA


class VectorZeroedAtTruncation(VectorWrong):
    def discount(self, terminated, truncated):
        return GAMMA * ~(terminated | truncated)


class VectorAnotherGamma(VectorWrong):
    def discount(self, terminated, truncated):
        return 0.99 * ~terminated


class VectorClippedF(VectorWrong):
    def transform(self, added):
        return np.clip(added, -1.5, 1.5)


class VectorClippedReward(VectorWrong):
    def total(self, rewards, added):
        return np.clip(rewards + added, -1.0, 1.0)


class VectorCentred(VectorWrong):
    def transform(self, added):
        return added + 0.8
