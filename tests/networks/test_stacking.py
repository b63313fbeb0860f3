"""Several networks as one stacked PyTree, and potentials made of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import small_network
from upslope.priors.potentials import constant_potential, mean_potential, stack

OBS = jnp.array([1.0, -2.0, 0.3])
NETWORKS = tuple(small_network(seed) for seed in range(3))


def test_mapping_over_a_stack_equals_each_network_alone():
    many_obs = 3 * jax.random.normal(jax.random.key(9), (50, 3))
    together = jax.vmap(lambda net: jax.vmap(net)(many_obs))(stack(list(NETWORKS)))
    for network, row in zip(NETWORKS, together, strict=True):
        np.testing.assert_allclose(row, jax.vmap(network)(many_obs), rtol=1e-5, atol=1e-6)


def test_mean_potential_by_hand():
    potential = mean_potential(stack(list(NETWORKS)), scale=2.0, bias=5.0)
    values = [float(network.value(OBS)) for network in NETWORKS]
    assert float(potential(OBS)) == pytest.approx(5 + 2 * sum(values) / 3, abs=1e-5)


def test_constant_potential_is_constant_and_of_the_same_form():
    networks = stack(list(NETWORKS))
    constant = constant_potential(networks, 7.5)
    assert float(constant(OBS)) == float(constant(-OBS)) == 7.5
    assert jax.tree.structure(constant) == jax.tree.structure(mean_potential(networks))
