"""The dueling network and the vanilla one: shapes, Eq. 6, the fixed scale of the inputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import small_network
from upslope.errors import UpslopeError
from upslope.networks.dueling import DuelingQ
from upslope.networks.q_network import QNetwork

SCALE = (0.5, 2.0, 10.0)
OBS = jnp.array([1.0, -2.0, 0.3])


@pytest.fixture(scope="module")
def many_obs():
    return 3 * jax.random.normal(jax.random.key(9), (50, 3))


def test_value_is_exactly_the_best_action_value(many_obs):
    network = small_network(actions=4)
    np.testing.assert_array_equal(jax.vmap(network.value)(many_obs), jax.vmap(network)(many_obs).max(axis=-1))


def test_heads_are_value_and_raw_advantage(many_obs):
    network = small_network(actions=4)
    value, advantage = jax.vmap(network.heads)(many_obs)
    np.testing.assert_array_equal(value, jax.vmap(network.value)(many_obs))
    assert np.abs(advantage.max(axis=-1)).min() > 1e-4, "the raw advantage is not centred"


def test_what_is_read_of_one_action_is_the_row_s_entry(many_obs):
    network = small_network(actions=4)
    rows, advantages = jax.vmap(network)(many_obs), jax.vmap(network.heads)(many_obs)[1]
    for action in range(4):
        taken = jnp.full(len(many_obs), action)
        np.testing.assert_array_equal(jax.vmap(network.q)(many_obs, taken), rows[:, action])
        np.testing.assert_array_equal(jax.vmap(network.advantage)(many_obs, taken), advantages[:, action])
    np.testing.assert_array_equal(jax.vmap(network.highest_advantage)(many_obs), advantages.max(axis=-1))
    np.testing.assert_array_equal(jax.vmap(network.best)(many_obs), rows.argmax(axis=-1))
    assert len(set(rows.argmax(axis=-1).tolist())) > 1


@pytest.mark.parametrize("kind", [DuelingQ, QNetwork])
def test_one_observation_gives_one_number_per_action(kind):
    assert kind(jax.random.key(0), 3, 4, (6, 5), SCALE)(OBS).shape == (4,)


def test_value_is_one_number():
    assert small_network().value(OBS).shape == ()


def test_a_vanilla_network_s_value_is_its_highest_q(many_obs):
    network = QNetwork(jax.random.key(0), 3, 4, (6, 5), SCALE)
    rows = np.asarray(jax.vmap(network)(many_obs))
    np.testing.assert_array_equal(jax.vmap(network.value)(many_obs), rows.max(axis=-1))
    np.testing.assert_array_equal(jax.vmap(network.best)(many_obs), rows.argmax(axis=-1))
    actions = jax.random.randint(jax.random.key(1), (len(rows),), 0, 4)
    taken = np.take_along_axis(rows, np.asarray(actions)[:, None], 1)[:, 0]
    np.testing.assert_array_equal(jax.vmap(network.q)(many_obs, actions), taken)


@pytest.mark.parametrize("kind", [DuelingQ, QNetwork])
def test_the_best_action_is_the_same_in_numpy(kind, many_obs):
    network = kind(jax.random.key(0), 3, 4, (6, 5), SCALE)
    found, expected = network.numpy_best()(np.asarray(many_obs)), jax.vmap(network.best)(many_obs)
    np.testing.assert_array_equal(found, expected)
    assert len(set(found.tolist())) > 1


@pytest.mark.parametrize("kind", [DuelingQ, QNetwork])
def test_random_actions_are_uniform(kind):
    drawn = kind(jax.random.key(0), 3, 4, (6, 5)).random_actions(jax.random.key(1), 20_000)
    np.testing.assert_allclose(np.bincount(drawn, minlength=4) / 20_000, 0.25, atol=0.013)


def test_the_default_is_the_paper_s_two_layers_of_32():
    network = DuelingQ(jax.random.key(0), 4, 2)
    assert [layer.weight.shape for layer in network.torso.layers] == [(32, 4), (32, 32)]
    assert network.value_head.weight.shape == (1, 32)
    assert network.advantage_head.weight.shape == (2, 32)


def test_networks_of_different_keys_differ():
    assert not np.allclose(small_network(0)(OBS), small_network(1)(OBS))


class TestInputScale:
    def test_it_is_not_a_trained_leaf(self):
        network = DuelingQ(jax.random.key(0), 3, 2, (6, 5), SCALE)
        # Weight and bias of two layers and two heads: 6·3 + 6 + 5·6 + 5 + 5 + 1 + 2·5 + 2 numbers.
        assert sum(leaf.size for leaf in jax.tree.leaves(network)) == 77
        assert len(jax.tree.leaves(network)) == 8

    def test_it_multiplies_the_observation(self):
        scaled = DuelingQ(jax.random.key(0), 3, 2, (6, 5), SCALE)
        plain = DuelingQ(jax.random.key(0), 3, 2, (6, 5))
        np.testing.assert_allclose(scaled(OBS), plain(OBS * jnp.asarray(SCALE)), rtol=1e-6)

    def test_it_survives_a_gradient_step(self):
        network = DuelingQ(jax.random.key(0), 3, 2, (6, 5), SCALE)
        gradient = jax.grad(lambda net: net.value(OBS))(network)
        assert jax.tree.map(lambda p, g: p - g, network, gradient).torso.scale == SCALE


class TestOfMaps:
    """Sec. 5.2: four layers of 32 3 × 3 kernels, two fully connected layers, both heads."""

    SHAPE = (5, 6, 4)

    @pytest.fixture(scope="class")
    @staticmethod
    def network():
        return DuelingQ(jax.random.key(0), TestOfMaps.SHAPE, 4, (16, 8), (1.0, 1.0, 2.0, 1.0))

    @pytest.fixture(scope="class")
    @staticmethod
    def maps():
        return jax.random.bernoulli(jax.random.key(1), 0.3, (7, *TestOfMaps.SHAPE)).astype(jnp.float32)

    def test_sizes_are_the_paper_s(self, network):
        assert [kernel.shape for kernel in network.torso.kernels] == [(3, 3, 4, 32), *[(3, 3, 32, 32)] * 3]
        assert [layer.weight.shape for layer in network.torso.dense.layers] == [(16, 5 * 6 * 32), (8, 16)]
        assert network.value_head.weight.shape == (1, 8)
        assert network.advantage_head.weight.shape == (4, 8)

    def test_value_is_exactly_the_best_action_value(self, network, maps):
        np.testing.assert_array_equal(jax.vmap(network.value)(maps), jax.vmap(network)(maps).max(axis=-1))

    def test_a_vanilla_network_takes_maps_too(self, maps):
        network = QNetwork(jax.random.key(0), self.SHAPE, 4, (16, 8))
        assert jax.vmap(network)(maps).shape == (7, 4)

    def test_two_axes_are_refused(self):
        with pytest.raises(UpslopeError, match=r"shape \(5, 6\)"):
            DuelingQ(jax.random.key(0), (5, 6), 4)
