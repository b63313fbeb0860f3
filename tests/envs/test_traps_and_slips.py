"""The whole pipeline on slippery maps with traps: Algorithm 1, DQN shaped by its prior, Algorithm 2."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.plain_grids import draw
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig
from upslope.experiments.maps.arms import grid_arms
from upslope.learners.dqn import DQN, for_maps
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.recipes import for_grid_games
from upslope.run.loop import broadcast, run
from upslope.tasks import grid_games

pytestmark = pytest.mark.slow

FAMILY = grid_games((3, 4), traps=0.1, slip=0.2, max_steps=10, flat=True)
RECIPE = dataclasses.replace(
    for_grid_games(4), hidden=(8, 8), steps_per_task=20, outer_warmup=0, averaging=0.5, snapshot_every=2,
    evaluation_tasks=2,
).with_posterior(environments=2)  # fmt: skip


@pytest.fixture(scope="module")
def maps():
    return jax.tree.map(jnp.asarray, draw(FAMILY, 2))


@pytest.fixture(scope="module")
def priors():
    learner = broadcast(MetaTraining(FAMILY, RECIPE), (1,))
    outcome = run(learner, jax.random.split(jax.random.key(0), 1), updates=4, every=2)
    assert np.isfinite(outcome.metrics["outer_loss"]).all()
    first, last = (jax.tree.map(lambda leaf, i=index: leaf[:, i], outcome.reports["prior"]) for index in (0, -1))
    assert any(np.any(a != b) for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(last), strict=True))
    return jax.tree.map(jnp.asarray, last)


@pytest.fixture(scope="module")
def arms(maps, priors):
    return grid_arms(FAMILY, maps, priors, priors, jnp.zeros(1))


def is_return(numbers):
    """Whether all numbers are possible expected returns of episodes that end with 1, -1 or 0."""
    return np.all((np.asarray(numbers) >= -1) & (np.asarray(numbers) <= 1))


@pytest.mark.parametrize("name", ["prior", "manhattan", "oracle"])
def test_shaped_dqn(maps, arms, name):
    shaping = jax.tree.map(lambda leaf: leaf[0], arms[name])
    config = dataclasses.replace(for_maps(), hidden=(8,), batch_size=8, replay_capacity=100)
    outcome = run(DQN(FAMILY, maps, shaping, config), jax.random.split(jax.random.key(1), 2), updates=20, every=10)
    assert np.isfinite(outcome.metrics["td_loss"]).all()
    assert is_return(outcome.reports["return"])
    assert np.abs(outcome.metrics["shaped_reward"][:, -1]).min() > 0, "nothing was shaped"


def test_potentials_by_hand_and_by_the_oracle_on_these_maps(maps, arms):
    manhattan, oracle = (np.asarray(arms[name].potential.values[0]) for name in ("manhattan", "oracle"))
    assert np.isfinite(oracle).all()
    assert np.all(oracle <= manhattan + 1e-6), "slips and traps only cost"
    assert np.any(oracle < manhattan - 0.01)
    idle = np.asarray(maps.obstacles | maps.traps).reshape(2, -1)
    np.testing.assert_array_equal(oracle[idle], 0)
    np.testing.assert_array_equal(oracle[np.arange(2), np.asarray(maps.goal)], 0)


def test_algorithm_2(maps, priors):
    config = AdaptationConfig(batch_size=8, replay_capacity=100, steps_per_update=20)
    learners = Adaptation(
        FAMILY, maps, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (2, *leaf.shape[1:])), priors),
        jnp.full(2, 0.03), config=config,
    )  # fmt: skip
    outcome = run(learners, jax.random.split(jax.random.key(2), 2), updates=6, every=3)
    assert np.isfinite(outcome.metrics["value_change"]).all()
    assert np.all(outcome.metrics["value_change"][:, -1] > 0)
    assert is_return(outcome.reports["return"])
