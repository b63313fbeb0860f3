"""Shaping wrappers as people write them: one right, the others each with one mistake. None of them is ours."""

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

GAMMA = 0.9


def phi(obs):
    """A potential whose level is far from zero, as learned ones are."""
    return 8.0 + 3.0 * float(obs[0]) - 2.0 * float(np.abs(obs[1]))


class Right(gym.Wrapper):
    """F = γ(1 − terminated)Φ(s') − Φ(s); the others change one method each."""

    gamma = GAMMA

    def __init__(self, env):
        super().__init__(env)
        self.last, self.steps = None, 0

    def phi(self, obs):
        return phi(obs)

    def reset(self, **arguments):
        obs, info = self.env.reset(**arguments)
        self.last = self.phi(obs)
        return obs, info

    def step(self, action):
        obs, reward, terminated, truncated, info = self.env.step(action)
        self.steps += 1
        ahead = self.ahead(obs, terminated, truncated)
        added = self.bent(self.gamma * ahead - self.last)
        self.last = self.phi(obs)
        return obs, self.total(reward, added), terminated, truncated, info

    def ahead(self, obs, terminated, truncated):
        return 0.0 if terminated else self.phi(obs)

    def bent(self, added):
        return added

    def total(self, reward, added):
        return reward + added


class NeverApplied(Right):
    def total(self, reward, added):
        return reward


class TerminalPotential(Right):
    def ahead(self, obs, terminated, truncated):
        return self.phi(obs)


class TerminalPotentialWhereBoth(Right):
    def ahead(self, obs, terminated, truncated):
        return 0.0 if terminated and not truncated else self.phi(obs)


class ZeroedAtTruncation(Right):
    def ahead(self, obs, terminated, truncated):
        return 0.0 if terminated or truncated else self.phi(obs)


class AnotherGamma(Right):
    gamma = 0.99


class NoGamma(Right):
    gamma = 1.0


class ClippedF(Right):
    def bent(self, added):
        return float(np.clip(added, -1.5, 1.5))


class ClippedReward(Right):
    def total(self, reward, added):
        return float(np.clip(reward + added, -1.0, 1.0))


class RunningNormalised(Right):
    def __init__(self, env):
        super().__init__(env)
        self.values = []

    def bent(self, added):
        self.values.append(added)
        return (added - np.mean(self.values)) / (np.std(self.values) + 1.0)


class Centred(Right):
    def bent(self, added):
        return added + 0.8


class TwoVersions(Right):
    """Φ moves on after 250 steps, but is checked against its first version."""

    def phi(self, obs):
        return phi(obs) if self.steps < 250 else phi(obs) + float(np.sin(5 * obs[0]))


class Growing(Right):
    """Φ's weight changes with every step."""

    def phi(self, obs):
        return phi(obs) * (1.0 + self.steps / 1000)


class NotRearmed(Right):
    """The first step of an episode takes Φ(s) from the last episode's end."""

    def reset(self, **arguments):
        obs, info = self.env.reset(**arguments)
        self.last = self.phi(obs) if self.last is None else self.last
        return obs, info


class FirstStepUnpaid(Right):
    def reset(self, **arguments):
        result = self.env.reset(**arguments)
        self.last = None
        return result

    def step(self, action):
        obs, reward, terminated, truncated, info = self.env.step(action)
        ahead = self.ahead(obs, terminated, truncated)
        added = 0.0 if self.last is None else self.gamma * ahead - self.last
        self.last = self.phi(obs)
        return obs, reward + added, terminated, truncated, info


class EndNotPaid(Right):
    def step(self, action):
        last = self.last
        obs, reward, terminated, truncated, info = super().step(action)
        if terminated:
            reward += last
        return obs, reward, terminated, truncated, info


class SomethingElse(Right):
    """A bonus for being somewhere: no difference of potentials."""

    def bent(self, added):
        return self.last


class NotANumber(Right):
    """Its Φ breaks after a while; the checker is given the same Φ."""


def breaking_phi(obs):
    return float("nan") if obs[0] > 4.0 else phi(obs)


class VectorRight(gym.vector.VectorWrapper):
    """The twin, right in all three modes."""

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
    """Same-step: the observation returned is taken for the successor."""

    def successors(self, obs, done, infos):
        return obs


class VectorDummyPaid(VectorRight):
    """Next-step: the reset is paid like a transition."""

    def at_dummies(self, added):
        return added


class Hides(gym.vector.VectorWrapper):
    """Takes the final observation out of the infos, after shaping rightly."""

    def step(self, actions):
        *rest, infos = self.env.step(actions)
        infos.pop("final_obs", None)
        return (*rest, infos)
