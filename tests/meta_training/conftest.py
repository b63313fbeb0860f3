"""Two small maps, and Algorithm 1's state and experience before its first iteration."""

import dataclasses

import jax
import pytest

from support.finite import moved


@pytest.fixture(scope="module")
def maps():
    """The family."""
    from upslope.tasks import grid_games

    return grid_games((3, 4), obstacles=0.15)


@pytest.fixture(scope="module")
def meta(maps):
    from upslope.meta_training.algorithm1 import MetaTraining
    from upslope.meta_training.recipes import for_grid_games

    config = dataclasses.replace(for_grid_games(4), hidden=(8, 8), steps_per_task=60, outer_warmup=0)
    return MetaTraining(maps, config.with_posterior(environments=4))


@pytest.fixture(scope="module")
def state(meta):
    return jax.jit(lambda: meta.init(jax.random.key(0)))()


@pytest.fixture(scope="module")
def tasks(maps):
    return maps.sample_many(jax.random.key(3), 2)


@pytest.fixture(scope="module")
def samples(meta, state, tasks):
    """All experience from both maps."""
    return jax.jit(lambda tasks: meta.collect(jax.random.key(1), tasks, state.theta, state.iteration)())(tasks)


@pytest.fixture(scope="module")
def theta(state):
    return moved(state.theta)


@pytest.fixture(scope="module")
def observations(samples):
    """Observations of every state of the first map."""
    return samples.observations[0]
