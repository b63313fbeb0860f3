"""What a network says of every state of a finite task, looked up: the same as asking the network."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close, largest
from support.plain_grids import draw
from upslope.adaptation import algorithm2 as adaptation
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, AdvantageHead
from upslope.adaptation.controls import CentredTD, FrozenPotential
from upslope.learners.lookups import looked_up
from upslope.networks.dueling import DuelingQ
from upslope.tasks import cartpoles, grid_games

MAPS = grid_games((4, 5), traps=0.1)
TASK = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), draw(MAPS, 1))
NETWORK = DuelingQ(jax.random.key(1), MAPS.observation_shape, 4, (8, 8))


def test_both_heads_in_every_state():
    everywhere = looked_up(MAPS, TASK, NETWORK)
    for obs in MAPS.env.observe_all(TASK):
        value, advantage = NETWORK.heads(obs)
        np.testing.assert_allclose(everywhere.value(obs), value, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(everywhere.advantage(obs), advantage, rtol=1e-4, atol=1e-5)


def test_states_that_can_t_be_listed_are_not_looked_up():
    poles = cartpoles()
    assert looked_up(poles, poles.sample(jax.random.key(0)), DuelingQ(jax.random.key(1), 4, 2)) is None


@pytest.mark.parametrize(
    "rule", [AdvantageHead(), FrozenPotential(), CentredTD()], ids=lambda rule: type(rule).__name__
)
def test_adapting_with_what_was_looked_up_is_adapting_with_the_network(rule, monkeypatch):
    config = AdaptationConfig(batch_size=8, replay_capacity=60, steps_per_update=20, epsilon=1.0)
    learner = Adaptation(MAPS, TASK, NETWORK, jnp.asarray(0.01), rule, config)

    def adapted():
        state = jax.jit(lambda key: learner.init(key))(jax.random.key(2))
        assert (state.everywhere is None) == (adaptation.looked_up is not looked_up)
        step = jax.jit(lambda state: learner.step(state))  # a new function: no program of the other way serves it
        for _ in range(3):
            state, metrics = step(state)
        return state.phi, metrics, jax.jit(lambda state: learner.report(state))(state)

    found = adapted()
    monkeypatch.setattr(adaptation, "looked_up", lambda *_: None)
    expected = adapted()
    assert_trees_close(found, expected, rtol=1e-3, atol=1e-5)
    assert largest(jax.tree.map(jnp.subtract, found[0], NETWORK)) > 1e-4
