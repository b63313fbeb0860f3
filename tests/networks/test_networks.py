"""The networks: shapes, the dueling aggregation, the fixed input scale, stacking."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import upslope
from support.batches import small_network
from upslope.errors import UpslopeError
from upslope.learners.dqn import DQN, for_maps
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.networks.actor_critic import Actor, Critic
from upslope.networks.convolution_forms import FORMS
from upslope.networks.dueling import MLP, DuelingQ, QNetwork, convolutional_torso, with_convolutions
from upslope.priors.potentials import constant_potential, mean_potential, stack

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
    np.testing.assert_array_equal(advantage, jax.vmap(network.advantage)(many_obs))
    assert np.abs(advantage.max(axis=-1)).min() > 1e-4, "the raw advantage is not centred"


@pytest.mark.parametrize(("name", "function"), [("relu", lambda x: np.maximum(x, 0)), ("tanh", np.tanh)])
def test_mlp_by_hand(name, function):
    mlp = MLP(jax.random.key(0), 2, (5,), (10.0, 1.0), name)
    layer, x = mlp.layers[0], np.array([0.05, 0.1], np.float32)
    before = np.asarray(layer.weight) @ (x * [10.0, 1.0]) + np.asarray(layer.bias)
    assert before.min() < 0 < before.max(), "both halves of the activation are looked at"
    np.testing.assert_allclose(mlp(jnp.asarray(x)), function(before), atol=1e-6)


@pytest.mark.parametrize("kind", [DuelingQ, QNetwork, Actor])
def test_one_observation_gives_one_number_per_action(kind):
    assert kind(jax.random.key(0), 3, 4, (6, 5), SCALE)(OBS).shape == (4,)


def test_value_is_one_number():
    assert small_network().value(OBS).shape == ()


def test_critic_takes_observation_and_action_to_one_number():
    critic = Critic(jax.random.key(0), 3, 2, (6, 5), SCALE)
    assert critic(OBS, jnp.array([0.1, 0.2])).shape == ()
    assert critic.torso.scale == (*SCALE, 1.0, 1.0), "actions come in [−1, 1] already"


def test_actor_is_bounded_and_tanh_of_its_pre_activation():
    actor = Actor(jax.random.key(0), 3, 4, (6, 5))
    action = actor(100 * OBS)
    assert np.abs(action).max() <= 1
    np.testing.assert_allclose(action, np.tanh(actor.pre_activation(100 * OBS)), rtol=1e-6)


def test_the_default_is_the_paper_s_two_layers_of_32():
    network = DuelingQ(jax.random.key(0), 4, 2)
    assert [layer.weight.shape for layer in network.torso.layers] == [(32, 4), (32, 32)]
    assert network.value_head.weight.shape == (1, 32)
    assert network.advantage_head.weight.shape == (2, 32)


class TestInputScale:
    def test_it_is_no_trained_leaf(self):
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


class TestConvolutional:
    """Sec. 5.2: four layers of 32 3 × 3 kernels, two fully connected layers, both heads."""

    SHAPE = (5, 6, 4)

    @pytest.fixture(scope="class")
    @staticmethod
    def network():
        return DuelingQ(jax.random.key(0), TestConvolutional.SHAPE, 4, (16, 8), (1.0, 1.0, 2.0, 1.0))

    @pytest.fixture(scope="class")
    @staticmethod
    def maps():
        return jax.random.bernoulli(jax.random.key(1), 0.3, (7, *TestConvolutional.SHAPE)).astype(jnp.float32)

    def test_sizes_are_the_paper_s(self, network):
        assert [kernel.shape for kernel in network.torso.kernels] == [(3, 3, 4, 32), *[(3, 3, 32, 32)] * 3]
        assert [layer.weight.shape for layer in network.torso.dense.layers] == [(16, 5 * 6 * 32), (8, 16)]
        assert network.value_head.weight.shape == (1, 8)
        assert network.advantage_head.weight.shape == (4, 8)

    def test_value_is_exactly_the_best_action_value(self, network, maps):
        np.testing.assert_array_equal(jax.vmap(network.value)(maps), jax.vmap(network)(maps).max(axis=-1))

    def test_every_form_gives_the_same_values_and_gradients(self, maps):
        torso = convolutional_torso(jax.random.key(0), self.SHAPE, (5,), channels=(3, 2))

        @jax.jit
        def loss_and_gradient(torso):
            loss, gradient = jax.value_and_grad(lambda torso: jnp.mean(jnp.sin(jax.vmap(torso)(maps))))(torso)
            return [loss, *jax.tree.leaves(gradient)]

        with jax.default_matmul_precision("highest"):
            expected = loss_and_gradient(dataclasses.replace(torso, convolution="lax"))
            for form in sorted(FORMS):
                found = loss_and_gradient(dataclasses.replace(torso, convolution=form))
                for ours, theirs in zip(found, expected, strict=True):
                    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6)

    def test_by_hand_where_a_kernel_only_looks_at_one_neighbour(self):
        torso = convolutional_torso(jax.random.key(0), (2, 3, 1), (4,), (3.0,), channels=(1,))
        left = jnp.zeros((3, 3, 1, 1)).at[1, 0].set(1.0)
        torso = dataclasses.replace(torso, kernels=(left,), biases=(jnp.array([0.5]),))
        maps = jnp.arange(6.0).reshape(2, 3, 1)
        # Each cell sees three times its left neighbour, nothing beyond the border, plus the bias.
        seen = jnp.array([[0, 0, 3], [0, 9, 12]]) + 0.5
        np.testing.assert_allclose(torso(maps), torso.dense(seen.ravel()), rtol=1e-5)

    def test_the_scale_is_by_channel(self, network, maps):
        plain = eqx.tree_at(lambda net: net.torso, network, dataclasses.replace(network.torso, scale=(1.0,) * 4))
        doubled = maps * jnp.array([1.0, 1.0, 2.0, 1.0])
        np.testing.assert_allclose(jax.vmap(network)(maps), jax.vmap(plain)(doubled), rtol=1e-4, atol=1e-6)

    def test_a_vanilla_network_takes_maps_too(self, maps):
        network = QNetwork(jax.random.key(0), self.SHAPE, 4, (16, 8))
        assert jax.vmap(network)(maps).shape == (7, 4)

    def test_two_axes_are_refused(self):
        with pytest.raises(UpslopeError, match=r"shape \(5, 6\)"):
            DuelingQ(jax.random.key(0), (5, 6), 4)


class TestStacking:
    networks = tuple(small_network(seed) for seed in range(3))

    def test_mapping_over_a_stack_equals_each_network_alone(self, many_obs):
        together = jax.vmap(lambda net: jax.vmap(net)(many_obs))(stack(list(self.networks)))
        for network, row in zip(self.networks, together, strict=True):
            np.testing.assert_allclose(row, jax.vmap(network)(many_obs), rtol=1e-5, atol=1e-6)

    def test_mean_potential_by_hand(self):
        potential = mean_potential(stack(list(self.networks)), scale=2.0, bias=5.0)
        values = [float(network.value(OBS)) for network in self.networks]
        assert float(potential(OBS)) == pytest.approx(5 + 2 * sum(values) / 3, abs=1e-5)

    def test_constant_potential_is_constant_and_of_the_same_form(self):
        networks = stack(list(self.networks))
        constant = constant_potential(networks, 7.5)
        assert float(constant(OBS)) == float(constant(-OBS)) == 7.5
        assert jax.tree.structure(constant) == jax.tree.structure(mean_potential(networks))


def test_networks_of_different_keys_differ():
    assert not np.allclose(small_network(0)(OBS), small_network(1)(OBS))


class TestPrecision:
    def test_fewer_bits_move_the_values_of_a_convolutional_network_a_little(self):
        obs = jax.random.uniform(jax.random.key(1), (4, 5, 4))
        exact = DuelingQ(jax.random.key(0), (4, 5, 4), 3)
        rough = with_convolutions(exact, "bfloat16")
        assert rough.torso.precision == "bfloat16"
        assert 0 < np.abs(rough(obs) - exact(obs)).max() < 0.05
        np.testing.assert_array_equal(with_convolutions(rough, "float32")(obs), exact(obs))

    def test_a_network_without_convolutions_stays_as_it_is(self):
        network = QNetwork(jax.random.key(0), 4, 2)
        assert with_convolutions(network, "bfloat16") is network

    def test_learners_ask_for_it(self):
        maps = upslope.obstacle_maps()
        theta = jax.eval_shape(
            MetaTraining(maps, MetaTrainingConfig(precision="bfloat16")).init, jax.random.key(0)
        ).theta
        task = maps.sample(jax.random.key(1))
        settings = dataclasses.replace(for_maps(), precision="tensorfloat32")
        learner = jax.eval_shape(DQN(maps, task, None, settings).init, jax.random.key(0))
        assert (theta.torso.precision, learner.network.torso.precision) == ("bfloat16", "tensorfloat32")

    def test_an_unknown_one(self):
        with pytest.raises(UpslopeError, match="no precision 'half': choose float32"):
            with_convolutions(QNetwork(jax.random.key(0), 4, 2), "half")
