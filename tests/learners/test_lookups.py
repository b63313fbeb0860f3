"""Tables of a network's outputs in every state of a finite task: the same values as the network's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close, largest
from support.plain_grids import draw
from upslope.adaptation import algorithm2
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, AdvantageHead
from upslope.adaptation.controls import CentredTD, FrozenPotential
from upslope.learners.lookups import dueling_table
from upslope.networks.dueling import DuelingQ, DuelingTable
from upslope.tasks import cartpoles, grid_games

MAPS = grid_games((4, 5), traps=0.1)
TASK = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), draw(MAPS, 1))
NETWORK = DuelingQ(jax.random.key(1), MAPS.observation_shape, 4, (8, 8))


def test_every_reading_in_every_state():
    table = dueling_table(MAPS, TASK, NETWORK)
    assert isinstance(table, DuelingTable)
    for obs in MAPS.env.observe_all(TASK):
        (value, outputs), (expected, expected_outputs) = table.heads(obs), NETWORK.heads(obs)
        np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(outputs, expected_outputs, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(table.value(obs), NETWORK.value(obs), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(table(obs), NETWORK(obs), rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(table.highest_advantage(obs), outputs.max(), rtol=1e-6)
        np.testing.assert_allclose(table.advantage(obs, 2), outputs[2], rtol=1e-6)
        np.testing.assert_allclose(table.q(obs, 2), NETWORK.q(obs, 2), rtol=1e-4, atol=1e-5)
        assert int(table.best(obs)) == int(NETWORK.best(obs))


def test_where_states_can_t_be_listed_it_is_the_network_itself():
    poles, network = cartpoles(), DuelingQ(jax.random.key(1), 4, 2)
    assert dueling_table(poles, poles.sample(jax.random.key(0)), network) is network


@pytest.mark.parametrize(
    "rule", [AdvantageHead(), FrozenPotential(), CentredTD()], ids=lambda rule: type(rule).__name__
)
def test_adapting_with_tables_is_adapting_with_the_network(rule, monkeypatch):
    config = AdaptationConfig(batch_size=8, replay_capacity=60, steps_per_update=20, epsilon=1.0)
    learner = Adaptation(MAPS, TASK, NETWORK, jnp.asarray(0.01), rule, config)

    def adapted(kind):
        state = jax.jit(lambda key: learner.init(key))(jax.random.key(2))
        assert type(state.evaluated) is type(state.prior) is kind
        step = jax.jit(lambda state: learner.step(state))  # a new function: no program of the other way serves it
        for _ in range(3):
            state, metrics = step(state)
        return state.phi, metrics, jax.jit(lambda state: learner.report(state))(state)

    found = adapted(DuelingTable)
    monkeypatch.setattr(algorithm2, "dueling_table", lambda family, task, network: network)
    expected = adapted(DuelingQ)
    assert_trees_close(found, expected, rtol=1e-3, atol=1e-5)
    assert largest(jax.tree.map(jnp.subtract, found[0], NETWORK)) > 1e-4
