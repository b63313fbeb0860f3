"""Torsos: layers by hand, JAX and both NumPy forms against each other, and which torso takes which observations."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.errors import UpslopeError
from upslope.networks.convolution_forms import FORMS
from upslope.networks.convolutional import ConvolutionalTorso, convolutional_torso
from upslope.networks.mlp import MLP
from upslope.networks.tensors import to_tensors
from upslope.networks.torsos import TORSOS, fresh_torso, torso_class

#: For each torso: the shape of an observation, and a scale for each input or channel.
OBSERVATIONS = {MLP: ((3,), (0.5, 2.0, 10.0)), ConvolutionalTorso: ((5, 6, 3), (1.0, 0.5, 2.0))}
HIDDEN = (7, 4)


def test_every_torso_is_tested_here():
    assert set(OBSERVATIONS) == set(TORSOS.values())


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("kind", OBSERVATIONS)
class TestEveryTorso:
    def torso(self, kind, activation):
        shape, scale = OBSERVATIONS[kind]
        return fresh_torso(jax.random.key(0), shape, HIDDEN, scale, activation)

    def batch(self, kind):
        return jax.random.normal(jax.random.key(1), (9, *OBSERVATIONS[kind][0]))

    def test_it_takes_its_observations(self, kind, activation):
        torso = self.torso(kind, activation)
        assert torso_class(OBSERVATIONS[kind][0]) is type(torso) is kind
        assert torso.hidden == HIDDEN
        assert jax.vmap(torso)(self.batch(kind)).shape == (9, HIDDEN[-1])

    def test_numpy_features_are_jax_s_and_a_row_of_ones(self, kind, activation):
        torso, obs = self.torso(kind, activation), self.batch(kind)
        expected = np.asarray(jax.vmap(torso)(obs))
        features = torso.numpy_features()
        for count in (9, 1, 4):  # one function serves batches of all sizes
            rows = features(np.asarray(obs[:count]))
            np.testing.assert_allclose(rows[:-1].T, expected[:count], rtol=1e-5, atol=1e-6)
            np.testing.assert_array_equal(rows[-1], 1.0)
        assert np.ptp(expected) > 0.01

    def test_its_twin_from_tensors_is_jax_s_in_double_precision(self, kind, activation):
        torso, obs = self.torso(kind, activation), self.batch(kind)
        tensors = {f"torso.{name}": tensor for name, tensor in to_tensors(torso).items()}
        shapes = kind.twin.tensor_shapes(OBSERVATIONS[kind][0], HIDDEN)
        assert {name: tensor.shape for name, tensor in tensors.items()} == shapes
        twin = kind.twin(tensors, HIDDEN, torso.scale, activation)
        with jax.enable_x64(True):
            exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), torso)
            expected = np.asarray(jax.vmap(exact)(jnp.asarray(np.asarray(obs), jnp.float64)))
        np.testing.assert_allclose(twin.batch(np.asarray(obs)), expected, rtol=0, atol=1e-12)
        ones = [twin.one(np.asarray(each)) for each in obs]
        np.testing.assert_allclose(ones, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(twin.batch(np.asarray(obs)), jax.vmap(torso)(obs), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", [(), (5, 6), (2, 3, 4, 5)])
def test_other_observations_are_refused(shape):
    with pytest.raises(UpslopeError, match="No network takes observations of shape"):
        torso_class(shape)
    with pytest.raises(UpslopeError, match="use vectors, or images with channels"):
        fresh_torso(jax.random.key(0), shape, HIDDEN, None)


@pytest.mark.parametrize(("name", "function"), [("relu", lambda x: np.maximum(x, 0)), ("tanh", np.tanh)])
def test_mlp_by_hand(name, function):
    mlp = MLP(jax.random.key(0), 2, (5,), (10.0, 1.0), name)
    layer, x = mlp.layers[0], np.array([0.05, 0.1], np.float32)
    before = np.asarray(layer.weight) @ (x * [10.0, 1.0]) + np.asarray(layer.bias)
    assert before.min() < 0 < before.max(), "both halves of the activation are looked at"
    np.testing.assert_allclose(mlp(jnp.asarray(x)), function(before), atol=1e-6)


class TestConvolutional:
    SHAPE = (5, 6, 4)

    @pytest.fixture(scope="class")
    @staticmethod
    def maps():
        return jax.random.bernoulli(jax.random.key(1), 0.3, (7, *TestConvolutional.SHAPE)).astype(jnp.float32)

    @pytest.mark.slow
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

    def test_the_scale_is_by_channel(self, maps):
        scaled = fresh_torso(jax.random.key(0), self.SHAPE, (16, 8), (1.0, 1.0, 2.0, 1.0))
        plain = dataclasses.replace(scaled, scale=(1.0,) * 4)
        doubled = maps * jnp.array([1.0, 1.0, 2.0, 1.0])
        np.testing.assert_allclose(jax.vmap(scaled)(maps), jax.vmap(plain)(doubled), rtol=1e-4, atol=1e-6)
        assert np.abs(jax.vmap(scaled)(maps) - jax.vmap(plain)(maps)).max() > 0.01
