"""Algorithm 1's outer gradient, kept and stopped, by hand; averaging; the report; settings that are refused."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import random_batch, small_network
from support.comparing import assert_trees_close, assert_trees_identical
from support.differences import assert_gradient
from support.probes import discrete_family
from upslope.errors import UpslopeError
from upslope.maml import adapt
from upslope.meta_training import MetaTraining, MetaTrainingConfig, TaskSamples, best_snapshot

TASKS, BATCH, ALPHA = 2, 3, 0.1
TINY = MetaTrainingConfig(
    iterations=4, tasks=TASKS, steps_per_task=8, batch_size=BATCH, hidden=(6, 5), inner_step_size=ALPHA,
    outer_updates=2, evaluation_tasks=3, evaluation_episodes=2,
)  # fmt: skip


def learner(**changes) -> MetaTraining:
    return MetaTraining(discrete_family(), dataclasses.replace(TINY, **changes))


def samples(*, fixed_targets=True) -> TaskSamples:
    """Random transitions of two tasks, TD targets from a network that is not θ."""
    batch = random_batch(4, leading=(TASKS, BATCH))
    target = small_network(7)
    return TaskSamples(batch, jax.vmap(jax.vmap(target))(batch.next_obs) if fixed_targets else None)


def of_task(data, index):
    return jax.tree.map(lambda leaf: leaf[index], data)


def outer_gradient(meta, theta, data):
    return jax.jit(lambda net: jax.grad(meta.outer_loss)(net, data))(theta)


@pytest.fixture
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.usefixtures("float64")
class TestKeptGraph:
    """The literal reading of Eq. 7: gradients flow through φ(θ) as well."""

    @pytest.mark.parametrize("inner_steps", [1, 2])
    def test_with_constant_td_targets_it_is_the_exact_gradient(self, inner_steps):
        meta, theta, data = learner(outer_target="kept", inner_steps=inner_steps), small_network(0), samples()
        objective = jax.jit(lambda net: meta.outer_loss(net, data))
        assert_gradient(objective, theta, outer_gradient(meta, theta, data), rtol=1e-5)

    def test_with_full_td_gradients_it_is_the_exact_gradient(self):
        meta = learner(outer_target="kept", td_gradient="full", target_decay=None)
        theta, data = small_network(0), samples(fixed_targets=False)
        objective = jax.jit(lambda net: meta.outer_loss(net, data))
        assert_gradient(objective, theta, outer_gradient(meta, theta, data), rtol=1e-5)

    def test_first_order_takes_the_posterior_s_jacobian_for_the_identity(self):
        meta, theta, data = learner(outer_target="kept", first_order=True), small_network(0), samples()
        ours = outer_gradient(meta, theta, data)
        expected = mean_of_pull(meta, theta, data, through_posterior=True)
        assert_trees_close(ours, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("float64")
class TestStoppedTarget:
    """Q_φ as a constant target: the gradient is that of a regression on Q_φ."""

    @pytest.mark.parametrize("first_order", [False, True])
    def test_it_is_the_regression_s_gradient(self, first_order):
        meta, theta, data = learner(first_order=first_order), small_network(0), samples()
        ours = outer_gradient(meta, theta, data)
        assert_trees_close(ours, mean_of_pull(meta, theta, data), rtol=1e-9, atol=1e-12)

    def test_it_differs_from_the_kept_one(self):
        theta, data = small_network(0), samples()
        stopped, kept = (outer_gradient(learner(outer_target=how), theta, data) for how in ("stopped", "kept"))
        assert float(jnp.abs(stopped.value_head.bias - kept.value_head.bias).max()) > 1e-4


def mean_of_pull(meta, theta, data, *, through_posterior=False):
    """Mean over tasks and samples of 2·(Q_θ − Q_φ)·∇Q_θ; less ∇Q_φ where that is let through."""
    gradients = []
    for task in range(TASKS):
        own = of_task(data, task)
        phi = adapt(meta.task_td_loss, theta, own, step_size=ALPHA)
        for index in range(BATCH):
            obs, action = own.batch.obs[index], own.batch.action[index]
            (q, slope), (target, target_slope) = (
                jax.value_and_grad(lambda net, obs=obs, action=action: net(obs)[action])(net) for net in (theta, phi)
            )
            if through_posterior:
                slope = jax.tree.map(jnp.subtract, slope, target_slope)
            gradients.append(jax.tree.map(lambda g, pull=2 * (q - target): pull * g, slope))
    return jax.tree.map(lambda *leaves: sum(leaves) / len(leaves), *gradients)


class TestTDLoss:
    """Mean of Eq. 5 over a task's batch, by either kind of target."""

    def expected(self, next_q):
        batch, theta = of_task(samples().batch, 0), small_network(0)
        errors = [
            float(batch.reward[i] + batch.discount[i] * next_q[i].max() - theta(batch.obs[i])[batch.action[i]])
            for i in range(BATCH)
        ]
        return np.mean(np.square(errors))

    def test_with_the_averaged_network_s_targets(self):
        own = of_task(samples(), 0)
        loss = learner().task_td_loss(small_network(0), own)
        assert float(loss) == pytest.approx(self.expected(own.next_q), rel=1e-5)

    def test_with_its_own_targets(self):
        own = of_task(samples(fixed_targets=False), 0)
        next_q = jax.vmap(small_network(0))(own.batch.next_obs)
        assert float(learner().task_td_loss(small_network(0), own)) == pytest.approx(self.expected(next_q), rel=1e-5)

    def test_semi_and_full_gradients_differ_only_with_own_targets(self):
        theta = small_network(0)
        for fixed, differ in ((True, False), (False, True)):
            own = of_task(samples(fixed_targets=fixed), 0)
            semi, full = (
                jax.grad(learner(td_gradient=kind).task_td_loss)(theta, own).value_head.bias
                for kind in ("semi", "full")
            )
            assert bool(jnp.abs(semi - full).max() > 1e-3) is differ


@pytest.fixture(scope="module")
def states():
    """Before the first iteration, and after each of three."""
    meta = learner(averaging=0.75)
    step, states = jax.jit(meta.step), [meta.init(jax.random.key(0))]
    for _ in range(3):
        states.append(step(states[-1])[0])
    return states


def blend(share, new, old):
    return jax.tree.map(lambda a, b: share * a + (1 - share) * b, new, old)


class TestAveraging:
    def test_the_average_follows_theta_by_its_decay(self, states):
        for before, after in itertools.pairwise(states):
            assert_trees_close(after.average, blend(0.25, after.theta, before.average))
            assert float(jnp.abs(after.theta.value_head.bias - before.theta.value_head.bias).max()) > 1e-4

    def test_the_target_follows_theta_by_its_own(self, states):
        for before, after in itertools.pairwise(states):
            assert_trees_close(after.target, blend(0.1, after.theta, before.target))

    def test_both_start_as_theta(self, states):
        assert_trees_identical(states[0].average, states[0].theta)
        assert_trees_identical(states[0].target, states[0].theta)

    def test_without_averaging_the_prior_is_theta_as_printed(self):
        theta, old = small_network(0), small_network(1)
        assert_trees_close(learner(averaging=0.0)._average(theta, old), theta, rtol=1e-6)


class TestCollecting:
    @pytest.fixture(scope="class")
    @staticmethod
    def collected():
        meta = learner(tasks=3, steps_per_task=200, epsilon=(0.0, 1.0))
        theta = meta.init(jax.random.key(0)).theta
        tasks = meta.family.sample_many(jax.random.key(1), 3)
        return theta, jax.jit(meta.collect)(jax.random.key(2), tasks, theta)

    def test_each_task_has_its_own_epsilon(self, collected):
        theta, batch = collected
        greedy = jnp.argmax(jax.vmap(jax.vmap(theta))(batch.obs), axis=-1)
        strayed = np.mean(batch.action != greedy, axis=1)
        # Half of the random actions of two are greedy ones: 0, 1/4 and 1/2, give or take three standard deviations.
        assert strayed[0] == 0
        np.testing.assert_allclose(strayed[1:], [0.25, 0.5], atol=0.11)

    def test_samples_are_of_their_own_task(self, collected):
        theta, batch = collected
        marked = batch._replace(reward=jnp.broadcast_to(jnp.arange(3.0)[:, None], batch.reward.shape))
        drawn = learner(tasks=3).draw(jax.random.key(3), marked, theta)
        np.testing.assert_array_equal(drawn.batch.reward, np.broadcast_to(np.arange(3.0)[:, None], (3, BATCH)))
        np.testing.assert_allclose(drawn.next_q, jax.vmap(jax.vmap(theta))(drawn.batch.next_obs), rtol=1e-5)

    def test_without_an_averaged_network_there_are_no_fixed_targets(self, collected):
        theta, batch = collected
        assert learner(tasks=3, target_decay=None).draw(jax.random.key(3), batch, theta).next_q is None


class TestOptimiser:
    def test_plain_descent_falls_linearly_from_first_to_last_step_size(self):
        # 4 iterations of 2 outer updates: β = 0.8 before the first of 8 steps, 0 after the last.
        optimiser = learner(outer_optimiser="sgd", outer_step_size=0.8, outer_step_size_end=0.0)._optimiser()
        state, steps = optimiser.init(jnp.zeros(())), []
        for _ in range(9):
            change, state = optimiser.update(jnp.ones(()), state)
            steps.append(float(change))
        np.testing.assert_allclose(steps, -0.1 * np.arange(8, -1, -1), atol=1e-6)

    def test_adam_is_indifferent_to_the_gradient_s_scale(self):
        optimiser = learner(outer_step_size=0.8)._optimiser()
        for scale in (1.0, 1e3):
            change, _ = optimiser.update(jnp.asarray(scale), optimiser.init(jnp.zeros(())))
            assert float(change) == pytest.approx(-0.8, rel=1e-3)


class TestSnapshots:
    @pytest.mark.parametrize(
        ("returns", "share", "expected"),
        [
            ([90, 10, 20, 30, 25], 0.5, 3),  # from the middle on; the 90 is too early
            ([90, 10, 20, 30, 25], 0.0, 0),
            ([90, 10, 20, 30, 25], 1.0, 4),  # the last, as printed
            ([10, 50, 20, 50, 30], 0.0, 3),  # of equals the last
            ([90, 10, 20, 30, 25], 0.6, 3),  # 0.6·4 = 2.4 lies after the third
            ([5], 0.5, 0),
        ],
    )
    def test_the_best_of_the_last_share(self, returns, share, expected):
        assert best_snapshot(np.array(returns, float), MetaTrainingConfig(select_from=share)) == expected

    def test_snapshots_are_tried_on_the_same_tasks(self, states):
        # The same network must earn the same, whatever was drawn in between.
        meta = learner()
        later = dataclasses.replace(states[0], key=jax.random.key(99))
        report = jax.jit(meta.report)
        assert float(report(states[0])["return"]) == float(report(later)["return"])
        assert all(np.array_equal(*map(jax.random.key_data, (s.trial_key, states[0].trial_key))) for s in states)


class TestReport:
    def test_it_changes_nothing(self):
        meta = learner()
        state = meta.init(jax.random.key(0))
        copy = jax.tree.map(jnp.copy, state)
        first, second = jax.jit(meta.report)(state), jax.jit(meta.report)(state)
        assert_trees_identical(state, copy)
        assert_trees_identical(first, second)

    def test_it_is_the_average_network_and_its_return(self):
        meta = learner()
        state = meta.init(jax.random.key(0))
        report = jax.jit(meta.report)(state)
        assert_trees_identical(report["prior"], state.average)
        assert report["return"].shape == ()


class TestSettings:
    @pytest.mark.parametrize(
        "name",
        ["iterations", "tasks", "steps_per_task", "batch_size", "inner_steps", "outer_updates", "snapshot_every"],
    )
    @pytest.mark.parametrize("value", [0, -3])
    def test_counts_are_at_least_one(self, name, value):
        with pytest.raises(UpslopeError, match=f"{name} is {value}"):
            MetaTrainingConfig(**{name: value})
