"""What random steps show: spread of the observations, discounted returns, and the scaling made from them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from upslope.meta_training.statistics import Statistics, discounted_returns, joined
from upslope.types import Transition


def row(places, rewards, discounts, successors):
    """One row of steps with observations of one component."""
    column = lambda numbers: jnp.asarray(numbers, jnp.float32)[:, None]  # noqa: E731
    return Transition(
        column(places), jnp.zeros(len(places), jnp.int32), jnp.asarray(rewards, jnp.float32),
        jnp.asarray(discounts, jnp.float32), column(successors),
    )  # fmt: skip


def random_steps(seed, shape=(3, 5), inputs=2, size=1.0, shift=0.0):
    keys = jax.random.split(jax.random.key(seed), 3)
    obs, next_obs = (shift + size * jax.random.normal(key, (*shape, inputs)) for key in keys[:2])
    reward = jax.random.normal(keys[2], shape)
    return Transition(obs, jnp.zeros(shape, jnp.int32), reward, jnp.full(shape, 0.9), next_obs)


class TestReturns:
    def test_they_add_up_along_an_episode(self):
        steps = row([0, 1, 2], [1.0, 2.0, 4.0], [0.5, 0.5, 0.5], [1, 2, 3])
        np.testing.assert_allclose(discounted_returns(steps), [1 + 0.5 * (2 + 0.5 * 4), 2 + 0.5 * 4, 4])

    def test_they_end_where_an_episode_terminates(self):
        steps = row([0, 1, 0], [1.0, 2.0, 4.0], [0.5, 0.0, 0.5], [1, 2, 1])
        np.testing.assert_allclose(discounted_returns(steps), [2.0, 2.0, 4.0])

    def test_they_end_where_an_episode_is_truncated(self):
        # The discount stays γ there, and the next step begins elsewhere.
        steps = row([0, 1, 7], [1.0, 2.0, 4.0], [0.5, 0.5, 0.5], [1, 2, 8])
        np.testing.assert_array_equal(joined(steps), [True, False, False])
        np.testing.assert_allclose(discounted_returns(steps), [2.0, 2.0, 4.0])

    def test_rows_do_not_mix(self):
        one, two = random_steps(0), random_steps(1)
        both = jax.tree.map(lambda a, b: jnp.stack([a, b]), one, two)
        np.testing.assert_allclose(discounted_returns(both)[1], discounted_returns(two), rtol=1e-6)


class TestStatistics:
    @settings(max_examples=15)
    @given(st.integers(1, 3), st.floats(-50, 50), st.floats(0.01, 20))
    def test_in_parts_they_are_those_of_all_steps(self, parts, shift, size):
        steps = [random_steps(seed, size=size, shift=shift) for seed in range(parts)]
        statistics = Statistics.none(2)
        for part in steps:
            statistics = statistics.with_steps(part)
        obs = np.concatenate([np.asarray(part.obs).reshape(-1, 2) for part in steps]).astype(np.float64)
        np.testing.assert_allclose(statistics.mean, obs.mean(0), rtol=1e-4, atol=1e-4 * size)
        np.testing.assert_allclose(np.sqrt(statistics.squares / statistics.count), obs.std(0), rtol=2e-3)
        np.testing.assert_array_equal(statistics.low, obs.min(0))
        np.testing.assert_array_equal(statistics.high, obs.max(0))

    def test_observations_become_of_the_order_of_one(self):
        steps = random_steps(0, shape=(10, 200), size=30.0, shift=400.0)
        seen = jax.vmap(jax.vmap(Statistics.none(2).with_steps(steps).scaling.normalise))(steps.obs)
        np.testing.assert_allclose(seen.mean((0, 1)), 0, atol=1e-4)
        np.testing.assert_allclose(seen.std((0, 1)), 1, rtol=1e-4)

    def test_what_never_changes_is_only_shifted(self):
        steps = row([3, 3, 3], [0, 0, 0], [0.5] * 3, [3, 3, 3])
        scaling = Statistics.none(1).with_steps(steps).scaling
        assert (float(scaling.mean[0]), float(scaling.deviation[0])) == (3.0, 1.0)

    def test_a_rare_flag_does_not_become_enormous(self):
        places = [0.0] * 9_999 + [1.0]
        steps = row(places, [0.0] * 10_000, [0.5] * 10_000, places)
        assert float(Statistics.none(1).with_steps(steps).scaling.normalise(jnp.ones(1))[0]) == pytest.approx(
            10, rel=1e-3
        )

    @pytest.mark.parametrize("factor", [1e-4, 1.0, -300.0])
    def test_returns_become_of_the_order_of_ten_whatever_the_reward(self, factor):
        steps = random_steps(0, shape=(10, 200))
        steps = steps._replace(reward=jnp.ones_like(steps.reward) * factor, next_obs=jnp.roll(steps.obs, -1, 1))
        unit = float(Statistics.none(2).with_steps(steps).scaling.unit)
        assert unit == pytest.approx(abs(factor) * 10 / 10, rel=0.01)  # returns end near 1 / (1 − 0.9)

    def test_without_any_reward_returns_stay_as_they_are(self):
        steps = random_steps(0)._replace(reward=jnp.zeros((3, 5)))
        assert float(Statistics.none(2).with_steps(steps).scaling.unit) == 1.0

    def test_the_level_is_the_value_of_random_steps_if_all_states_were_one(self):
        steps = row([0, 1, 2, 3], [1.0, 2.0, 3.0, 2.0], [0.9, 0.9, 0.9, 0.0], [1, 2, 3, 4])
        assert float(Statistics.none(1).with_steps(steps).scaling.level) == pytest.approx(2.0 / (1 - 0.675))
