"""Algorithm 1's outer gradient (kept, stopped, as printed), compared with hand computations and finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import random_batch, small_network
from support.comparing import assert_trees_close, assert_trees_identical, largest
from support.differences import assert_gradient
from support.meta import ALPHA, BATCH, TASKS, learner_by, outer_gradient, outer_loss
from support.probes import discrete_family
from upslope.equations.maml import adapt
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.posteriors.network import TaskBatch
from upslope.meta_training.recipes import as_printed


def samples(*, fixed_targets=True) -> TaskBatch:
    """Random transitions of two tasks, with TD targets from a network other than θ."""
    batch = random_batch(4, leading=(TASKS, BATCH))
    target = small_network(7)
    return TaskBatch(batch, jax.vmap(jax.vmap(target.value))(batch.next_obs) if fixed_targets else None)


def of_task(data, index):
    return jax.tree.map(lambda leaf: leaf[index], data)


def gradient_of(meta, theta, data):
    return jax.jit(lambda net: outer_gradient(meta, net, data)[1])(theta)


@pytest.fixture
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.usefixtures("float64")
class TestKeptGraph:
    """The literal reading of Eq. 7: gradients flow through φ(θ) as well."""

    @pytest.mark.parametrize("inner_steps", [pytest.param(1, marks=pytest.mark.slow), 2])
    def test_with_constant_td_targets_it_is_the_exact_gradient(self, inner_steps):
        meta, theta, data = learner_by(outer_target="kept", inner_steps=inner_steps), small_network(0), samples()
        objective = jax.jit(lambda net: outer_loss(meta, net, data))
        assert_gradient(objective, theta, gradient_of(meta, theta, data), rtol=1e-5)

    def test_with_full_td_gradients_it_is_the_exact_gradient(self):
        meta = learner_by(outer_target="kept", td_gradient="full", target_decay=None)
        theta, data = small_network(0), samples(fixed_targets=False)
        objective = jax.jit(lambda net: outer_loss(meta, net, data))
        assert_gradient(objective, theta, gradient_of(meta, theta, data), rtol=1e-5)

    def test_rematerialisation_does_not_change_it(self):
        """The gradient is equal, but the program recomputes the inner steps."""
        theta, data = small_network(0), samples()
        kept, again = (learner_by(outer_target="kept", inner_steps=2, rematerialise=how) for how in (False, True))
        assert_trees_close(gradient_of(again, theta, data), gradient_of(kept, theta, data), rtol=1e-9, atol=1e-12)
        assert "remat" in str(jax.make_jaxpr(lambda net: outer_loss(again, net, data))(theta))
        assert "remat" not in str(jax.make_jaxpr(lambda net: outer_loss(kept, net, data))(theta))

    def test_first_order_replaces_the_posterior_s_jacobian_by_the_identity(self):
        meta, theta, data = learner_by(outer_target="kept", first_order=True), small_network(0), samples()
        ours = gradient_of(meta, theta, data)
        expected = jax.jit(lambda net: mean_of_pull(meta, net, data, through_posterior=True))(theta)
        assert_trees_close(ours, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("float64")
class TestStoppedTarget:
    """Q_φ as a constant target: the gradient is that of a regression on Q_φ."""

    @pytest.mark.parametrize("first_order", [False, True])
    def test_it_is_the_regression_s_gradient(self, first_order):
        meta, theta, data = learner_by(first_order=first_order), small_network(0), samples()
        ours = gradient_of(meta, theta, data)
        expected = jax.jit(lambda net: mean_of_pull(meta, net, data))(theta)
        assert_trees_close(ours, expected, rtol=1e-9, atol=1e-12)

    def test_it_differs_from_the_kept_one(self):
        theta, data = small_network(0), samples()
        stopped, kept = (gradient_of(learner_by(outer_target=how), theta, data) for how in ("stopped", "kept"))
        assert float(jnp.abs(stopped.value_head.bias - kept.value_head.bias).max()) > 1e-4


def mean_of_pull(meta, theta, data, *, through_posterior=False):
    """Mean over tasks and samples of 2·(Q_θ − Q_φ)·∇Q_θ; minus ∇Q_φ if gradients flow through the posterior."""
    gradients = []
    for task in range(TASKS):
        own = of_task(data, task)
        phi = adapt(meta.config.posterior.td_loss, theta, own, step_size=ALPHA)
        for index in range(BATCH):
            obs, action = own.transitions.obs[index], own.transitions.action[index]
            (q, slope), (target, target_slope) = (
                jax.value_and_grad(lambda net, obs=obs, action=action: net(obs)[action])(net) for net in (theta, phi)
            )
            if through_posterior:
                slope = jax.tree.map(jnp.subtract, slope, target_slope)
            gradients.append(jax.tree.map(lambda g, pull=2 * (q - target): pull * g, slope))
    return jax.tree.map(lambda *leaves: sum(leaves) / len(leaves), *gradients)


class TestAsPrinted:
    """The settings that follow the paper literally."""

    meta = MetaTraining(
        discrete_family(),
        dataclasses.replace(as_printed(), tasks=TASKS, steps_per_task=8, hidden=(6, 5)).with_posterior(
            batch_size=BATCH
        ),
    )

    def test_an_iteration_is_one_gradient_step_on_equation_7(self):
        def both(state):
            _, task_key, collect_key, update_key = jax.random.split(state.key, 4)
            tasks = self.meta.family.sample_many(task_key, TASKS)
            experience = self.meta.collect(collect_key, tasks, state.theta, state.iteration)()
            data = self.meta.draw(jax.random.split(update_key, 1)[0], state, experience, state.target)
            gradient = jax.grad(lambda net: outer_loss(self.meta, net, data))(state.theta)
            by_hand = jax.tree.map(lambda p, g: p - self.meta.config.outer_step_size * g, state.theta, gradient)
            return by_hand, self.meta.step(state)[0]

        before = self.meta.init(jax.random.key(0))
        by_hand, after = jax.jit(both)(before)
        assert_trees_close(after.theta, by_hand)
        assert largest(jax.tree.map(jnp.subtract, after.theta, before.theta)) > 1e-6
        assert_trees_identical(after.average, after.theta)

    def test_its_gradient_is_exact(self, float64):
        theta, data = small_network(0), samples(fixed_targets=False)
        objective = jax.jit(lambda net: outer_loss(self.meta, net, data))
        assert_gradient(objective, theta, gradient_of(self.meta, theta, data), rtol=1e-5)


class TestTDLoss:
    """Mean of Eq. 5 over a task's batch, for either kind of target."""

    def expected(self, next_value):
        batch, theta = of_task(samples().transitions, 0), small_network(0)
        errors = [
            float(batch.reward[i] + batch.discount[i] * next_value[i] - theta(batch.obs[i])[batch.action[i]])
            for i in range(BATCH)
        ]
        return np.mean(np.square(errors))

    def test_with_the_averaged_network_s_targets(self):
        own = of_task(samples(), 0)
        loss = jax.jit(learner_by().config.posterior.td_loss)(small_network(0), own)
        assert float(loss) == pytest.approx(self.expected(own.next_value), rel=1e-5)

    def test_with_its_own_targets(self):
        own = of_task(samples(fixed_targets=False), 0)
        next_value = jax.vmap(small_network(0))(own.transitions.next_obs).max(axis=-1)
        loss = jax.jit(learner_by().config.posterior.td_loss)(small_network(0), own)
        assert float(loss) == pytest.approx(self.expected(next_value), rel=1e-5)

    def test_semi_and_full_gradients_differ_only_with_own_targets(self):
        theta = small_network(0)
        for fixed, differ in ((True, False), (False, True)):
            own = of_task(samples(fixed_targets=fixed), 0)
            semi, full = (
                jax.jit(jax.grad(learner_by(td_gradient=kind).config.posterior.td_loss))(theta, own).value_head.bias
                for kind in ("semi", "full")
            )
            assert bool(jnp.abs(semi - full).max() > 1e-3) is differ


@pytest.mark.parametrize("outer_target", ["kept", "stopped"])
def test_task_by_task_makes_no_difference(outer_target):
    theta, data = small_network(0), samples()
    results = []
    for by in (learner_by(outer_target=outer_target, task_by_task=how) for how in (False, True)):
        results.append(jax.jit(lambda net, by=by: outer_gradient(by, net, data))(theta))
    together, in_turn = results
    assert_trees_close(in_turn, together, rtol=1e-4)
    assert largest(together[1]) > 1e-4
