"""Φ in plain numpy: equal to JAX's, without JAX, by value, and fast enough for a simulator."""

import copy
import pickle
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope import NumpyPotential, Prior, load_prior
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import trained_on
from upslope.tasks import cartpoles

OBS = np.random.default_rng(0).normal(size=(200, 4)).astype(np.float32)


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("hidden", [(32, 32), (5,), (8, 7, 6)])
def test_equal_to_jax_in_double_precision(activation, hidden):
    network = DuelingQ(jax.random.key(1), 4, 2, hidden, cartpoles().observation_scale, activation)
    potential = Prior(network, trained_on(cartpoles(), network, 0, {})).to_numpy()
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), network)
        expected = np.asarray(jax.vmap(exact.value)(jnp.asarray(OBS, jnp.float64)))
    np.testing.assert_allclose(potential.values(OBS), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose([potential(obs) for obs in OBS], expected, rtol=0, atol=1e-12)


def test_equal_to_the_single_precision_that_learners_see(prior):
    np.testing.assert_allclose(prior.to_numpy().values(OBS), prior.values(jnp.asarray(OBS)), rtol=0, atol=1e-6)


def test_the_prior_that_ships_is_equal_to_jax_in_double_precision():
    """Its Φ goes up to 30, where single precision itself is no finer than 4e-6."""
    shipped = load_prior("cartpole")
    states = np.random.default_rng(1).uniform(-1, 1, (200, 4)) * [2.4, 2.0, 0.26, 2.0]
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), shipped.network)
        expected = np.asarray(jax.vmap(exact.value)(jnp.asarray(states)))
    assert np.ptp(expected) > 10
    np.testing.assert_allclose(shipped.to_numpy().values(states), expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(shipped.values(jnp.asarray(states, jnp.float32)), expected, rtol=1e-6)


def test_saved_and_loaded_without_jax(prior, tmp_path):
    prior.save(tmp_path / "prior.safetensors")
    code = (
        "import sys, numpy as np, gymnasium as gym, upslope\n"
        "potential = upslope.NumpyPotential.load(sys.argv[1])\n"
        "env = upslope.PotentialShaping(gym.make('CartPole-v1'), sys.argv[1], gamma=potential.gamma)\n"
        "env.reset(seed=0); env.step(1)\n"
        "assert not {'jax', 'equinox', 'torch'} & set(sys.modules), 'JAX was imported'\n"
        "print(repr(potential(np.array([0.1, -0.2, 0.05, 1.0], np.float32))))\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "prior.safetensors")]
    finished = subprocess.run(command, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    expected = prior.to_numpy()(np.array([0.1, -0.2, 0.05, 1.0], np.float32))
    assert float(finished.stdout) == pytest.approx(expected, abs=1e-12)


def test_copies_and_pickles_are_equal_by_value(prior):
    potential = prior.to_numpy()
    for twin in (copy.deepcopy(potential), pickle.loads(pickle.dumps(potential))):
        assert twin == potential
        assert hash(twin) == hash(potential)
        assert twin(OBS[0]) == potential(OBS[0])
    assert potential != NumpyPotential(potential.trained_on, {k: v + 1 for k, v in potential._tensors.items()})
    assert (potential == "a word") is False


def test_gamma_and_words(prior):
    assert prior.to_numpy().gamma == prior.gamma == 0.98
    assert repr(prior.to_numpy()) == "NumpyPotential(family='cartpole', gamma=0.98, seed=7)"
