"""Settings of a shaping wrapper: types of discounts, repeated actions, and invalid values."""

import numpy as np
import pytest

from support.scripted import EPISODES, GAMMA, F, Scripted, level
from upslope import PotentialShaping, UpslopeError
from upslope.wrappers.terms import Terms


class Learned:
    """A potential with a discount of its own."""

    gamma = 0.98

    def __call__(self, obs):
        return obs[0]


class TestDiscounts:
    @pytest.mark.parametrize("gamma", [np.float32(0.9), np.float64(0.9), np.array(0.9)[()]])
    def test_numpy_scalars_are_accepted(self, gamma):
        env = PotentialShaping(Scripted(*EPISODES), level, gamma)
        env.reset(seed=0)
        assert type(env.gamma) is float
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(F[0])

    def test_integers(self):
        assert Terms(level, 1).gamma == 1.0

    @pytest.mark.parametrize("gamma", [True, "0.98", None, np.float32(1.5), 1 + 0j, float("inf")])
    def test_invalid_discounts(self, gamma):
        with pytest.raises(UpslopeError, match=r"gamma is .* a discount lies in"):
            Terms(level, gamma)

    def test_a_prior_s_discount_rounded_to_float32_is_accepted(self):
        assert Terms(Learned(), np.float32(0.98)).gamma == float(np.float32(0.98))

    @pytest.mark.parametrize("gamma", [0.9799, 0.99, 0.98**4])
    def test_a_different_discount_is_refused(self, gamma):
        with pytest.raises(UpslopeError, match=r"learned with 0\.98: give gamma=0\.98 .* set repeat"):
            Terms(Learned(), gamma)


class TestRepeatedActions:
    @pytest.mark.parametrize("repeat", [2, 4, np.int64(4)])
    def test_the_discount_is_the_prior_s_to_the_power_of_the_repeat(self, repeat):
        assert Terms(Learned(), 0.98**repeat, repeat=repeat).gamma == pytest.approx(0.98**repeat, abs=1e-12)

    def test_the_discount_of_one_action_is_refused(self):
        with pytest.raises(UpslopeError, match=r"which is 0\.92236816 for 4 repeated actions: give gamma=0\.92236816"):
            Terms(Learned(), 0.98, repeat=4)

    def test_f_uses_the_discount_of_a_whole_step(self):
        env = PotentialShaping(Scripted(*EPISODES), Learned(), 0.98**3, repeat=3)
        env.reset(seed=0)
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(0.98**3 * 5 - 2)

    def test_without_a_prior_the_repeat_has_no_effect(self):
        assert Terms(level, GAMMA, repeat=4).gamma == GAMMA


class TestSettings:
    def test_numpy_scalars_are_accepted(self):
        terms = Terms(level, GAMMA, np.float32(2.0), np.int64(3), np.int64(5))
        assert (terms.scale, terms.bias, terms.anneal_steps) == (2.0, 3.0, 5)
        assert [terms.weight(step) for step in (0, 1, 5, 6)] == [1.0, 0.8, 0.0, 0.0]

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("scale", True), ("scale", "2"), ("bias", None), ("bias", float("nan")), ("anneal_steps", 2.5),
            ("anneal_steps", True), ("anneal_steps", 0), ("repeat", 0), ("repeat", 1.5), ("repeat", None),
        ],
    )  # fmt: skip
    def test_invalid_values_are_refused(self, name, value):
        with pytest.raises(UpslopeError, match=f"{name} is {value!r}"):
            Terms(level, GAMMA, **{name: value})
