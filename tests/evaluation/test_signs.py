"""What policy and potential show without a learner, for networks whose values are known by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.corridor import GAMMA, LIMIT, START, Known, constant, corridors, optimal
from upslope.evaluation.episodes import play
from upslope.evaluation.signs import signs
from upslope.learners.policies import Greedy

BOTH = jnp.array([0, 1, 0, 1])


def measured(network):
    return signs(corridors(), network, BOTH, jax.random.key(0))


class TestEpisodes:
    def test_of_an_optimal_policy(self):
        episodes = play(corridors(), jax.random.key(0), BOTH, Greedy(optimal()), optimal())
        np.testing.assert_array_equal(episodes.returns, np.ones(4))
        np.testing.assert_array_equal(episodes.counts.sum(1), [START] * 4)
        assert episodes.terminated.all()
        np.testing.assert_allclose(episodes.discounted, GAMMA ** (START - 1), rtol=1e-5)
        np.testing.assert_allclose(episodes.start_values, GAMMA ** (START - 1), rtol=1e-5)
        np.testing.assert_allclose(episodes.td_errors[episodes.counts], 0, atol=1e-6)

    def test_of_one_that_always_goes_down(self):
        network = constant(3.0)
        episodes = play(corridors(), jax.random.key(0), BOTH, Greedy(network), network)
        np.testing.assert_array_equal(episodes.returns, [1, 0, 1, 0])
        np.testing.assert_array_equal(episodes.counts.sum(1), [START, LIMIT, START, LIMIT])
        np.testing.assert_array_equal(episodes.terminated, [True, False, True, False])
        # Where the time limit ends the episode, V of the last state stands for the rest.
        np.testing.assert_allclose(episodes.discounted, [GAMMA ** (START - 1), 3 * GAMMA**LIMIT] * 2, rtol=1e-5)


class TestSigns:
    def test_of_the_optimal_network(self):
        found = measured(optimal())
        np.testing.assert_array_equal(found.greedy, np.ones(4))
        assert found.random.mean() < 0.7
        assert found.floor_share == 0
        assert found.calibration == pytest.approx(0, abs=1e-5)
        assert found.td_error == pytest.approx(0, abs=1e-5)
        assert found.rise == pytest.approx(1.0)
        assert found.drip == pytest.approx((GAMMA - 1) * found.level)
        assert found.warnings() == []

    def test_of_a_flat_one(self):
        found = measured(constant(3.0))
        assert found.is_flat
        assert found.rise is None
        assert found.level == pytest.approx(3.0)
        np.testing.assert_array_equal(found.greedy, [1, 0, 1, 0])
        split, flat = found.warnings()
        assert "Tasks are split: on 50%" in split
        assert "flat" in flat

    def test_of_one_whose_policy_leads_away(self):
        found = measured(Known(-optimal().table))
        np.testing.assert_array_equal(found.greedy, np.zeros(4))
        assert found.floor_share == 1
        assert "no better than random actions on 100%" in found.warnings()[0]
        assert not found.is_flat

    def test_where_nothing_ever_differs_only_that_is_said(self):
        found = measured(constant(3.0))
        assert found.differs
        (sentence,) = replace(found, differs=False).warnings()
        assert "Every step paid the same" in sentence

    @pytest.mark.parametrize("level", [-100.0, 0.0, 5.0])
    def test_a_level_does_not_hide_how_flat_it_is(self, level):
        slight = Known(optimal().table * 0.001 + level)
        assert measured(slight).is_flat
