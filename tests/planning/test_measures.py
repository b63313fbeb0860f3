"""Measures: by hand, against scipy, and against simulated episodes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import spearmanr

from support.plain_grids import draw, pick
from upslope.envs.grid import GridGame, read_map
from upslope.envs.grid_rules import DOWN, RIGHT
from upslope.learners.policies import Greedy
from upslope.planning.measures import (
    Measures,
    action_optimality,
    dead_units,
    feature_norm,
    measure,
    measure_all,
    rank_correlation,
    success,
    summarise,
    truth,
    truths,
)
from upslope.tasks import grid_games

GAMMA = 0.9


class TestRankCorrelation:
    @pytest.mark.parametrize("seed", range(4))
    def test_as_scipy_with_ties_over_the_states_that_count(self, seed):
        rng = np.random.default_rng(seed)
        ours, theirs = rng.integers(6, size=(2, 40)).astype(float) + np.outer([0.0, 1.0], np.arange(40) % 3)
        counted = rng.random(40) < 0.7
        found = rank_correlation(jnp.asarray(ours), jnp.asarray(theirs), jnp.asarray(counted))
        assert float(found) == pytest.approx(spearmanr(ours[counted], theirs[counted]).statistic, abs=1e-5)

    def test_a_constant_has_none(self):
        everywhere = jnp.ones(5, bool)
        assert float(rank_correlation(jnp.ones(5), jnp.arange(5.0), everywhere)) == 0.0

    def test_only_the_order_counts(self):
        x, everywhere = jnp.asarray([0.1, 0.7, 0.3, 0.9]), jnp.ones(4, bool)
        assert float(rank_correlation(jnp.exp(5 * x), x, everywhere)) == pytest.approx(1)
        assert float(rank_correlation(-x, x, everywhere)) == pytest.approx(-1)


class TestActionOptimality:
    def test_by_hand(self):
        optimal = jnp.asarray([[1.0, 1.0, 0.0], [0.0, 0.5, 0.2], [0.3, 0.1, 0.2], [9.0, 0.0, 0.0]])
        ours = jnp.asarray([[0.0, 5.0, 1.0], [0.0, 1.0, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        counted = jnp.asarray([True, True, True, False])
        assert float(action_optimality(ours, optimal, counted)) == pytest.approx(2 / 3)


class TestFeatures:
    def test_norm_by_hand(self):
        assert float(feature_norm(jnp.asarray([[3.0, 0.0], [0.0, 4.0]]))) == pytest.approx(2.5)

    def test_a_unit_that_never_changes_is_dead(self):
        features = jnp.asarray([[0.0, 2.0, 1.0, 0.0], [0.0, 2.0, 3.0, 0.0], [0.0, 2.0, 1.0, 1e-3]])
        assert float(dead_units(features)) == 0.5


class TestGreedyPolicies:
    one = read_map("""
        S..
        #..
        ..G
    """)
    game = GridGame(3, 3)

    def towards(self, *actions_by_cell):
        return jax.nn.one_hot(jnp.asarray(actions_by_cell), 4)

    def test_a_policy_that_arrives_and_one_that_does_not(self):
        known = truth(self.game, self.one, GAMMA)
        right_then_down = self.towards(3, 3, 1, 3, 3, 1, 3, 3, 0)
        found = measure(known, known.solution.value, right_then_down, steps=50)
        assert float(found.success) == 1
        assert float(found.discounted_return) == pytest.approx(GAMMA**3)
        assert float(found.optimal_return) == pytest.approx(GAMMA**3)
        assert (float(found.rank_correlation), float(found.squared_error)) == pytest.approx((1, 0))
        assert float(found.action_optimality) == 1
        always_left = self.towards(*[2] * 9)
        found = measure(known, known.solution.value, always_left, steps=50)
        assert (float(found.success), float(found.discounted_return), float(found.action_optimality)) == (0, 0, 0)

    def test_an_episode_is_only_so_long(self):
        known = truth(self.game, self.one, GAMMA)
        right_then_down = self.towards(3, 3, 1, 3, 3, 1, 3, 3, 0)
        assert [float(measure(known, known.solution.value, right_then_down, steps=n).success) for n in (3, 4)] == [0, 1]

    def test_a_slippery_corridor_by_hand(self):
        one = read_map("S.G", slip=0.4)
        known = truth(GridGame(1, 3, slippery=True), one, GAMMA)
        within = success(known.mdp, self.towards(RIGHT, RIGHT, DOWN), 3)
        # Two of three moves must go ahead, with 0.6 each.
        assert float(within[0]) == pytest.approx(0.6**2 + 2 * 0.6**2 * 0.4)

    def test_a_trap_is_no_success(self):
        one = read_map("STG")
        known = truth(GridGame(1, 3, traps=True), one, GAMMA)
        found = measure(known, known.solution.value, self.towards(RIGHT, RIGHT, RIGHT), steps=50)
        assert (float(found.success), float(found.discounted_return)) == (0, -1)

    def test_states_from_which_nothing_can_be_reached_do_not_count(self):
        one = read_map("S.G#.")
        np.testing.assert_array_equal(truth(GridGame(1, 5), one, GAMMA).states, [True, True, False, False, False])


class TestNetworks:
    def test_success_is_what_played_episodes_return(self):
        family = grid_games((5, 5))
        maps = draw(family, 60)
        network = Scores(jax.random.normal(jax.random.key(3), (25, 4)))
        found = measure_all(family.env, truths(family.env, maps, GAMMA), maps, network, family.max_steps)
        played = jax.jit(lambda key, maps: family.returns(key, maps, Greedy(network)))(jax.random.key(0), maps)
        np.testing.assert_allclose(found.success, played, atol=1e-6)
        assert 0 < float(np.mean(played)) < 1
        assert np.all(np.asarray(found.discounted_return) <= np.asarray(found.optimal_return) + 1e-6)

    def test_each_map_is_measured_by_its_own_truth(self):
        family = grid_games((5, 5))
        maps = draw(family, 4)
        network = Scores(jax.random.normal(jax.random.key(0), (25, 4)))
        every = measure_all(family.env, truths(family.env, maps, GAMMA), maps, network, 50)
        one = pick(maps, 2)
        q, value = network.q, network.q.max(-1)
        alone = measure(truth(family.env, one, GAMMA), value, q, 50)
        for name in Measures._fields:
            np.testing.assert_allclose(getattr(every, name)[2], getattr(alone, name), atol=1e-6)


class Scores(eqx.Module):
    """A 'network' that uses only the current position."""

    q: jax.Array

    def __call__(self, obs):
        return self.q[jnp.argmax(obs[..., 2])]

    def value(self, obs):
        return jnp.max(self(obs))

    def best(self, obs):
        return jnp.argmax(self(obs))


def test_summary_by_hand():
    numbers = jnp.asarray([0.5, 0.1, 0.6])
    found = summarise(Measures(*[numbers] * 6))
    assert found["success"] == pytest.approx({"mean": 0.4, "median": 0.5, "worst": 0.1})
    assert found["squared_error"]["worst"] == pytest.approx(0.6)
