"""Tables of a network's outputs in every state of a finite task: equal to the network's own outputs."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close, largest
from support.plain_grids import draw
from upslope.adaptation import algorithm2
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, Algorithm2
from upslope.adaptation.controls import CentredTD, FrozenPotential
from upslope.learners.lookups import dueling_table
from upslope.networks.dueling import DuelingQ, DuelingTable
from upslope.tasks import cartpoles, grid_games


@functools.cache
def case(flat=True):
    """A family of maps, one map and a network: an MLP on flat maps, else convolutions, which compile slowly."""
    maps = grid_games((4, 5), traps=0.1, flat=flat)
    task = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), draw(maps, 1))
    return maps, task, DuelingQ(jax.random.key(1), maps.observation_shape, 4, (8, 8))


def test_every_output_in_every_state():
    maps, task, network = case(flat=False)
    table = dueling_table(maps, task, network)
    assert isinstance(table, DuelingTable)
    read = jax.jit(lambda of, obs: (*of.heads(obs), of.value(obs), of(obs), of.q(obs, 2), of.best(obs)))
    for obs in maps.env.observe_all(task):
        (value, outputs, *others, best), (*expected, expected_best) = read(table, obs), read(network, obs)
        for actual, right in zip((value, outputs, *others), expected, strict=True):
            np.testing.assert_allclose(actual, right, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(table.highest_advantage(obs), outputs.max(), rtol=1e-6)
        np.testing.assert_allclose(table.advantage(obs, 2), outputs[2], rtol=1e-6)
        assert int(best) == int(expected_best)


def test_the_network_is_returned_where_states_cannot_be_listed():
    poles, network = cartpoles(), DuelingQ(jax.random.key(1), 4, 2)
    assert dueling_table(poles, poles.sample(jax.random.key(0)), network) is network


@pytest.mark.parametrize(
    ("rule", "flat"),
    [
        (Algorithm2(), True),
        pytest.param(Algorithm2(), False, marks=pytest.mark.slow),
        pytest.param(FrozenPotential(), False, marks=pytest.mark.slow),
        pytest.param(CentredTD(), False, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_adapting_with_tables_equals_adapting_with_the_network(rule, flat, monkeypatch):
    maps, task, network = case(flat)
    config = AdaptationConfig(batch_size=8, replay_capacity=60, steps_per_update=20, epsilon=1.0)
    learner = Adaptation(maps, task, network, jnp.asarray(0.01), rule, config)

    def adapted(kind):
        state = jax.jit(lambda key: learner.init(key))(jax.random.key(2))
        assert type(state.evaluated) is type(state.prior) is kind
        step = jax.jit(lambda state: learner.step(state))  # a new function, so that no compiled program is reused
        for _ in range(3):
            state, metrics = step(state)
        return state.phi, metrics, jax.jit(lambda state: learner.report(state))(state)

    actual = adapted(DuelingTable)
    monkeypatch.setattr(algorithm2, "dueling_table", lambda family, task, network: network)
    expected = adapted(DuelingQ)
    assert_trees_close(actual, expected, rtol=1e-3, atol=1e-5)
    assert largest(jax.tree.map(jnp.subtract, actual[0], network)) > 1e-4
