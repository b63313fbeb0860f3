"""The checker where episodes end: clipping that is visible only there, kinds of ends that never occur, γ = 1."""

import gymnasium as gym
import numpy as np
import pytest

from support import wrong_wrappers as zoo
from support.scripted import Walk
from support.wrong_wrappers import GAMMA, phi
from upslope import NumpyPotential, PotentialShaping, check_shaping
from upslope.priors.pretrained import prior_path


def names(report):
    return [finding.name for finding in report.findings]


class OnCartPole(zoo.Right):
    """Uses the bundled prior: F is large where a pole falls, and small elsewhere."""

    gamma = 0.98
    bounds = totals = (-np.inf, np.inf)

    def __init__(self):
        super().__init__(gym.make("CartPole-v1"))
        self.phi = NumpyPotential.load(prior_path("cartpole"))

    def transform(self, added):
        return float(np.clip(added, *self.bounds))

    def total(self, reward, added):
        return float(np.clip(reward + added, *self.totals))


class TestClippingOfEndsAlone:
    @pytest.mark.parametrize("bound", [1.0, 5.0, 20.0])
    def test_of_f(self, bound):
        env = OnCartPole()
        env.bounds = (-bound, bound)
        report = check_shaping(env, env.phi, 0.98, steps=600)
        assert names(report) == ["clipped"]
        assert f"F never leaves {-bound:.4g} to" in report.findings[0].evidence

    @pytest.mark.parametrize("bound", [5.0, 10.0])
    def test_of_the_sum(self, bound):
        env = OnCartPole()
        env.totals = (-bound, bound)
        assert names(check_shaping(env, env.phi, 0.98, steps=600)) == ["clipped"]

    def test_bounds_that_are_never_reached(self):
        env = OnCartPole()
        env.bounds = env.totals = (-100.0, 100.0)
        assert check_shaping(env, env.phi, 0.98, steps=600).findings == ()


class Endless(Walk):
    def step(self, action):
        obs, reward, *_ = super().step(action)
        return obs, reward, False, False, {}


class TestKindsOfEnds:
    def test_all_are_forced_where_none_occur(self):
        right = check_shaping(zoo.Right(Endless()), phi, GAMMA, steps=600)
        assert min(right.counts.values()) >= 3
        assert str(right).endswith(" potential-based: no mistakes were found.")
        wrong = check_shaping(zoo.TerminalPotential(Endless()), phi, GAMMA, steps=600)
        assert names(wrong) == ["nonzero_terminal_potential"]

    def test_kinds_that_did_not_occur_are_named(self):
        report = check_shaping(zoo.TerminalPotential(Walk()), phi, GAMMA, steps=1)
        assert names(report)[0] == "not_judged"
        assert "kinds: terminated, truncated, both." in report.findings[0].evidence
        assert not report.ok
        assert "Potential-based" not in str(report)


def test_with_a_gamma_of_one_a_bias_is_visible_only_at_terminations():
    for scale, bias in ((1.0, 3.0), (0.3, -2.0)):
        shaped = PotentialShaping(Walk(), phi, 1.0, scale=scale, bias=bias)
        assert check_shaping(shaped, phi, 1.0, steps=600).findings == ()
        assert names(check_shaping(shaped, phi, GAMMA, steps=600)) == ["gamma_mismatch"]

    class NoGammaAndTerminal(zoo.NoGamma, zoo.TerminalPotential):
        pass

    assert names(check_shaping(NoGammaAndTerminal(Walk()), phi, 1.0, steps=600)) == ["nonzero_terminal_potential"]
