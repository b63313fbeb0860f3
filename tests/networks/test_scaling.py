"""A scaling around a network: raw units outside, no gradient inside, the same in NumPy and in files."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.networks.dueling import DuelingQ
from upslope.networks.scaling import Scaling
from upslope.priors.prior import Prior, trained_on
from upslope.tasks import cartpoles

MEAN, DEVIATION = jnp.array([1.0, -2.0, 0.5, 300.0]), jnp.array([0.1, 4.0, 1.0, 50.0])
SCALING = Scaling(MEAN, DEVIATION, unit=jnp.array(7.0), level=jnp.array(-40.0))


@pytest.fixture(scope="module")
def network():
    return DuelingQ(jax.random.key(0), 4, 3, (8, 8), (1.0,) * 4, "tanh", scaling=SCALING)


@pytest.fixture(scope="module")
def obs():
    return np.asarray(SCALING.mean + SCALING.deviation * jax.random.normal(jax.random.key(1), (20, 4)))


def test_values_are_those_of_the_plain_network_in_units_of_the_return(network, obs):
    plain = network.with_scaling(None)
    inputs = (obs - np.asarray(SCALING.mean)) / np.asarray(SCALING.deviation)
    for name, level in (("value", -40.0), ("highest_advantage", 0.0), ("__call__", -40.0)):
        scaled, unscaled = (jax.vmap(getattr(net, name))(x) for net, x in ((network, obs), (plain, inputs)))
        np.testing.assert_allclose(scaled, level + 7.0 * unscaled, rtol=1e-5, atol=1e-4)
    np.testing.assert_array_equal(jax.vmap(network.best)(obs), jax.vmap(plain.best)(inputs))


def test_the_value_is_the_maximum_of_q(network, obs):
    np.testing.assert_array_equal(jax.vmap(network.value)(obs), jax.vmap(network)(obs).max(-1))


def test_no_gradient_reaches_it(network, obs):
    gradient = eqx.filter_grad(lambda net: jnp.sum(jax.vmap(net)(obs) ** 2))(network)
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(gradient.scaling))
    assert np.any(gradient.value_head.weight)


def test_in_numpy_it_acts_the_same(network, obs):
    np.testing.assert_array_equal(network.numpy_best()(obs), jax.vmap(network.best)(obs))


def test_a_file_brings_it_back(obs, tmp_path):
    network = DuelingQ(jax.random.key(0), 4, 2, (8, 8), (1.0,) * 4, "tanh", scaling=SCALING)
    prior = Prior(network, trained_on(cartpoles(), network, 0, {}))
    prior.save(tmp_path / "prior.safetensors")
    loaded = Prior.load(tmp_path / "prior.safetensors")
    np.testing.assert_array_equal(loaded(obs), prior(obs))
    np.testing.assert_allclose(loaded.to_numpy().values(obs), prior(obs), rtol=1e-4, atol=1e-4)
    assert loaded.to_numpy()(obs[0]) == pytest.approx(float(prior(obs[0])), rel=1e-4, abs=1e-4)


def test_an_untouched_network_has_none():
    assert DuelingQ(jax.random.key(0), 4, 3).scaling is None


def test_a_file_of_a_network_without_factors_has_one_for_each_input(tmp_path):
    network = DuelingQ(jax.random.key(0), 4, 2, (8,))
    prior = Prior(network, trained_on(cartpoles(), network, 0, {}))
    prior.save(tmp_path / "prior.safetensors")
    assert Prior.load(tmp_path / "prior.safetensors").trained_on.observation_scale == (1.0,) * 4
