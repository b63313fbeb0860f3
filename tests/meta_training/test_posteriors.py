"""Every task-posterior goes through Algorithm 1, and those that don't fit a family are refused."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from support.comparing import largest
from support.meta import TINY, outer_loss
from support.probes import continuous_family, discrete_family
from upslope.errors import UpslopeError
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import POSTERIORS
from upslope.meta_training.posteriors.finite import AbstractFinitePosterior
from upslope.meta_training.recipes import for_grid_games
from upslope.tasks import grid_games

NAMES = sorted(POSTERIORS)
FINITE = [name for name in NAMES if issubclass(POSTERIORS[name], AbstractFinitePosterior)]
TASKS, STEPS = 2, 20


def config_of(name) -> MetaTrainingConfig:
    return MetaTrainingConfig(
        iterations=4, tasks=TASKS, steps_per_task=STEPS, hidden=(8,), outer_updates=1, outer_step_size=0.01,
        evaluation_tasks=1, evaluation_episodes=1, posterior=POSTERIORS[name](inner_step_size=0.5, inner_steps=2),
    )  # fmt: skip


def test_names_are_those_of_the_classes():
    assert {name: POSTERIORS[name]().name for name in NAMES} == {name: name for name in NAMES}
    assert FINITE == ["heads", "table", "weights"]


@pytest.mark.parametrize("name", NAMES)
def test_an_iteration_of_algorithm_1(name):
    """Its metrics and its step equal those of the posterior's parts, combined by hand."""
    meta = MetaTraining(grid_games((3, 4), flat=True, obstacles=0.15), config_of(name))
    posterior = meta.config.posterior

    @jax.jit
    def iterate(state):
        gathered = meta.gather(state)
        after, metrics = meta.update(state, gathered)
        keys = jax.random.split(jax.random.split(jax.random.split(state.key, 4)[3], 1)[0], TASKS)
        drawn = posterior.draw(keys, gathered, state.target)
        loss, gradient = jax.value_and_grad(lambda net: outer_loss(meta, net, drawn))(state.theta)
        change, _ = meta.config.optimiser().update(gradient, state.optimiser)
        return after, metrics, loss, jax.tree.map(jnp.add, state.theta, change), gradient

    before = meta.init(jax.random.key(0))
    after, metrics, loss, theta, gradient = iterate(before)
    assert float(metrics["outer_loss"]) == pytest.approx(float(loss), rel=1e-3)
    assert float(loss) > 0
    assert largest(gradient) > 1e-3
    assert metrics["reward"].shape == (TASKS,)
    # Adam's first step is the sign of the gradient: where that is not zero, both must have the same sign.
    for ours, theirs, slope in zip(*map(jax.tree.leaves, (after.theta, theta, gradient)), strict=True):
        clear = jnp.abs(slope) > 1e-4
        assert largest(jnp.where(clear, ours - theirs, 0.0)) < 1e-5
    assert largest(jax.tree.map(jnp.subtract, after.theta, before.theta)) == pytest.approx(0.01, rel=0.01)


@pytest.mark.parametrize("name", FINITE)
def test_tasks_whose_states_cannot_be_listed(name):
    meta = MetaTraining(discrete_family(), config_of(name))
    with pytest.raises(UpslopeError, match=f"'{name}' needs tasks whose states can be listed.*NetworkPosterior"):
        meta.init(jax.random.key(0))


def test_the_recipe_for_maps_does_not_fit_vectors():
    with pytest.raises(UpslopeError, match="probe can't"):
        MetaTraining(discrete_family(), for_grid_games(4)).init(jax.random.key(0))


def test_actions_without_a_matching_head():
    with pytest.raises(UpslopeError, match="no advantage head for continuous actions"):
        MetaTraining(continuous_family(), TINY).init(jax.random.key(0))


def test_a_head_that_does_not_exist():
    with pytest.raises(UpslopeError, match="no advantage head 'other' for discrete actions"):
        MetaTraining(discrete_family(), dataclasses.replace(TINY, head="other")).init(jax.random.key(0))
