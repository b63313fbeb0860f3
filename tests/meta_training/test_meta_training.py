"""Algorithm 1 around its gradient: experience, averaging, step sizes, snapshots, the report, refused settings."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close, assert_trees_identical, largest
from support.meta import BATCH, TINY, learner, learner_by
from support.probes import discrete_family, observation_dependent
from upslope.errors import UpslopeError
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior, TablePosterior


@pytest.fixture(scope="module")
def states():
    """States before the first iteration and after each of three."""
    meta = learner(averaging=0.75)
    step, states = jax.jit(meta.step), [meta.init(jax.random.key(0))]
    for _ in range(3):
        states.append(step(states[-1])[0])
    return states


def blend(share, new, old):
    return jax.tree.map(lambda a, b: share * a + (1 - share) * b, new, old)


class TestAveraging:
    def test_the_average_follows_theta_with_its_decay(self, states):
        for before, after in itertools.pairwise(states):
            assert_trees_close(after.average, blend(0.25, after.theta, before.average))
            assert float(jnp.abs(after.theta.value_head.bias - before.theta.value_head.bias).max()) > 1e-4

    def test_the_target_follows_theta_with_its_own_decay(self, states):
        for before, after in itertools.pairwise(states):
            assert_trees_close(after.target, blend(0.1, after.theta, before.target))

    def test_both_start_as_theta(self, states):
        assert_trees_identical(states[0].average, states[0].theta)
        assert_trees_identical(states[0].target, states[0].theta)

    @pytest.mark.slow
    def test_without_averaging_the_prior_is_theta(self):
        meta = learner(averaging=0.0)
        before = meta.init(jax.random.key(0))
        after = jax.jit(meta.step)(before)[0]
        assert_trees_close(after.average, after.theta, rtol=1e-6)
        assert largest(jax.tree.map(jnp.subtract, after.theta, before.theta)) > 1e-4

    @pytest.mark.slow
    def test_without_an_averaged_network_the_target_is_theta(self):
        meta = learner_by(target_decay=None)
        after = jax.jit(meta.step)(meta.init(jax.random.key(0)))[0]
        assert_trees_identical(after.target, after.theta)

    def test_compiled_families_collect_with_the_newest_theta(self, states):
        for state in states:
            assert_trees_identical(state.acting, state.theta)


class TestCollecting:
    @pytest.fixture(scope="class")
    @staticmethod
    def collected():
        meta = learner(tasks=3, steps_per_task=200, epsilon=(0.0, 1.0))
        theta = meta.init(jax.random.key(0)).theta
        tasks = meta.family.sample_many(jax.random.key(1), 3)
        collect = jax.jit(lambda key, tasks, theta: meta.collect(key, tasks, theta, jnp.asarray(0))())
        return theta, collect(jax.random.key(2), tasks, theta)

    def test_each_task_has_its_own_epsilon(self, collected):
        theta, batch = collected
        greedy = jnp.argmax(jax.vmap(jax.vmap(theta))(batch.obs), axis=-1)
        strayed = np.mean(batch.action != greedy, axis=1)
        # Half of the random actions are greedy: shares of 0, 1/4 and 1/2, within three standard deviations.
        assert strayed[0] == 0
        np.testing.assert_allclose(strayed[1:], [0.25, 0.5], atol=0.11)

    def test_samples_come_from_their_own_task(self, collected):
        theta, batch = collected
        marked = batch._replace(reward=jnp.broadcast_to(jnp.arange(3.0)[:, None], batch.reward.shape))
        drawn = TINY.posterior.draw(jax.random.split(jax.random.key(3), 3), marked, theta)
        np.testing.assert_array_equal(drawn.transitions.reward, np.broadcast_to(np.arange(3.0)[:, None], (3, BATCH)))
        expected = jax.vmap(jax.vmap(theta))(drawn.transitions.next_obs).max(axis=-1)
        np.testing.assert_allclose(drawn.next_value, expected, rtol=1e-5)

    def test_without_an_averaged_network_there_are_no_fixed_targets(self, collected):
        theta, batch = collected
        keys = jax.random.split(jax.random.key(3), 3)
        assert NetworkPosterior(target_decay=None).draw(keys, batch, theta).next_value is None


class TestOptimiser:
    def test_plain_descent_falls_linearly_from_first_to_last_step_size(self):
        # 4 iterations of 2 outer updates: β = 0.8 before the first of 8 steps, 0 after the last.
        optimiser = learner(outer_optimiser="sgd", outer_step_size=0.8, outer_step_size_end=0.0).config.optimiser()
        state, steps = optimiser.init(jnp.zeros(())), []
        for _ in range(9):
            change, state = optimiser.update(jnp.ones(()), state)
            steps.append(float(change))
        np.testing.assert_allclose(steps, -0.1 * np.arange(8, -1, -1), atol=1e-6)

    def test_adam_is_indifferent_to_the_gradient_s_scale(self):
        optimiser = learner(outer_step_size=0.8).config.optimiser()
        for scale in (1.0, 1e3):
            change, _ = optimiser.update(jnp.asarray(scale), optimiser.init(jnp.zeros(())))
            assert float(change) == pytest.approx(-0.8, rel=1e-3)


class TestSnapshots:
    @pytest.mark.parametrize(
        ("returns", "share", "expected"),
        [
            ([90, 10, 20, 30, 25], 0.5, 3),  # the second half; the 90 is too early
            ([90, 10, 20, 30, 25], 0.0, 0),
            ([90, 10, 20, 30, 25], 1.0, 4),  # the last one, as in the paper
            ([10, 50, 20, 50, 30], 0.0, 3),  # the last one of equals
            ([90, 10, 20, 30, 25], 0.6, 3),  # 0.6·4 = 2.4 is after the third
            ([5], 0.5, 0),
        ],
    )
    def test_the_best_of_the_last_share(self, returns, share, expected):
        assert MetaTrainingConfig(select_from=share).best_snapshot(np.array(returns, float)) == expected

    def test_snapshots_are_evaluated_on_the_same_episodes(self, states):
        # Episodes start at random, and the return of −1 or 1 depends only on the start.
        meta = MetaTraining(
            discrete_family().only(observation_dependent()), dataclasses.replace(TINY, evaluation_tasks=20)
        )
        report = jax.jit(lambda key, trial_key: meta.report(
            dataclasses.replace(states[0], key=key, trial_key=trial_key))["return"])  # fmt: skip
        first, later, other = (
            float(report(jax.random.key(key), jax.random.key(trial))) for key, trial in ((0, 5), (1, 5), (0, 6))
        )
        assert first == later != other

    def test_the_evaluation_key_never_changes(self, states):
        for state in states:
            assert_trees_identical(state.trial_key, states[0].trial_key)


class TestReport:
    def test_it_changes_nothing(self):
        meta = learner()
        state = meta.init(jax.random.key(0))
        copy = jax.tree.map(jnp.copy, state)
        first, second = jax.jit(meta.report)(state), jax.jit(meta.report)(state)
        assert_trees_identical(state, copy)
        assert_trees_identical(first, second)

    def test_it_contains_the_average_network_and_its_return(self):
        meta = learner()
        state = meta.init(jax.random.key(0))
        report = jax.jit(meta.report)(state)
        assert_trees_identical(report["prior"], state.average)
        assert report["return"].shape == ()


class TestSettings:
    @pytest.mark.parametrize("name", ["iterations", "tasks", "steps_per_task", "outer_updates", "snapshot_every"])
    @pytest.mark.parametrize("value", [0, -3])
    def test_counts_are_at_least_one(self, name, value):
        with pytest.raises(UpslopeError, match=f"{name} is {value}"):
            MetaTrainingConfig(**{name: value})

    @pytest.mark.parametrize(
        ("posterior", "name"),
        [
            (NetworkPosterior, "batch_size"),
            (NetworkPosterior, "inner_steps"),
            (TablePosterior, "environments"),
            (TablePosterior, "inner_steps"),
        ],
    )
    @pytest.mark.parametrize("value", [0, -3])
    def test_counts_of_posteriors_are_at_least_one(self, posterior, name, value):
        with pytest.raises(UpslopeError, match=f"{name} is {value}"):
            posterior(**{name: value})

    @pytest.mark.parametrize("share", [-0.1, 1.5])
    def test_shares_lie_between_zero_and_one(self, share):
        for settings in ({"averaging": share}, {"select_from": share}, {"epsilon": (0.1, share)}):
            with pytest.raises(UpslopeError, match=f"is {share}, but it is a share"):
                MetaTrainingConfig(**settings)
        for posterior in (NetworkPosterior, TablePosterior):
            with pytest.raises(UpslopeError, match=f"target_decay is {share}"):
                posterior(target_decay=share)

    def test_some_of_the_posterior_s_settings_can_be_changed(self):
        config = TINY.with_posterior(inner_steps=7)
        assert config.posterior == dataclasses.replace(TINY.posterior, inner_steps=7)
        assert dataclasses.replace(config, posterior=TINY.posterior) == TINY
