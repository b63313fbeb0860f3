"""Typical hand-written shaping wrappers: one correct, the others with one mistake each. None of them is upslope's."""

import gymnasium as gym
import numpy as np

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
        added = self.transform(self.gamma * ahead - self.last)
        self.last = self.phi(obs)
        return obs, self.total(reward, added), terminated, truncated, info

    def ahead(self, obs, terminated, truncated):
        return 0.0 if terminated else self.phi(obs)

    def transform(self, added):
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
    def transform(self, added):
        return float(np.clip(added, -1.5, 1.5))


class ClippedReward(Right):
    def total(self, reward, added):
        return float(np.clip(reward + added, -1.0, 1.0))


class RunningNormalised(Right):
    def __init__(self, env):
        super().__init__(env)
        self.values = []

    def transform(self, added):
        self.values.append(added)
        return (added - np.mean(self.values)) / (np.std(self.values) + 1.0)


class Centred(Right):
    def transform(self, added):
        return added + 0.8


class TwoVersions(Right):
    """Φ changes after 150 steps, but is checked against its first version."""

    def phi(self, obs):
        return phi(obs) if self.steps < 150 else phi(obs) + float(np.sin(5 * obs[0]))


class TwoInTurn(Right):
    """Φ's weight alternates every fifty steps."""

    def phi(self, obs):
        return phi(obs) * (1.0 if self.steps % 100 < 50 else 1.3)


class Growing(Right):
    """Φ's weight changes with every step."""

    def phi(self, obs):
        return phi(obs) * (1.0 + self.steps / 1000)


class NotRearmed(Right):
    """The first step of an episode uses Φ(s) from the end of the last episode."""

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
    """A bonus for some states, which is not a difference of potentials."""

    def transform(self, added):
        return self.last


class SuccessorOnly(Right):
    """γΦ(s') without −Φ(s)."""

    def transform(self, added):
        return added + self.last


class ActionBonus(Right):
    """F plus a bonus for one action."""

    def step(self, action):
        obs, reward, *rest = super().step(action)
        return obs, reward + 0.05 * action, *rest


class StateBonus(Right):
    """F plus a bonus for some states."""

    def step(self, action):
        obs, reward, *rest = super().step(action)
        return obs, reward + float(obs[0] > 1), *rest


class LunarLanderStyle(TerminalPotential):
    """Ignores both γ and terminations: two mistakes at once."""

    gamma = 1.0


#: The finding that the checker must report for each.
WRONG = {
    NeverApplied: "never_applied",
    TerminalPotential: "nonzero_terminal_potential",
    TerminalPotentialWhereBoth: "nonzero_terminal_potential",
    ZeroedAtTruncation: "zeroed_at_truncation",
    AnotherGamma: "gamma_mismatch",
    NoGamma: "gamma_mismatch",
    ClippedF: "clipped",
    ClippedReward: "clipped",
    RunningNormalised: "normalised",
    Centred: "normalised",
    TwoVersions: "stale_mixture",
    TwoInTurn: "stale_mixture",
    Growing: "stale_mixture",
    NotRearmed: "not_rearmed_at_reset",
    FirstStepUnpaid: "not_rearmed_at_reset",
    EndNotPaid: "end_not_paid",
    SuccessorOnly: "not_potential_based",
    ActionBonus: "not_potential_based",
    StateBonus: "not_potential_based",
    SomethingElse: "not_potential_based",
}


def breaking_phi(obs):
    return float("nan") if obs[0] > 4.0 else phi(obs)
