"""The unrolled generator draws what JAX's own draws, bit for bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upslope.run.randomness import unroll

DRAWS = {
    "split": lambda key: jax.random.key_data(jax.random.split(key, (3, 2))),
    "fold_in": lambda key: jax.random.key_data(jax.random.fold_in(key, 2**31 + 5)),
    "uniform": lambda key: jax.random.uniform(key, (5, 3)),
    "normal": lambda key: jax.random.normal(key, (7,)),
    "randint": lambda key: jax.random.randint(key, (11,), 0, 1000),
    "bits of 8": lambda key: jax.random.bits(key, (9,), "uint8"),
    "bits of 16": lambda key: jax.random.bits(key, (9,), "uint16"),
    "bits of 32": lambda key: jax.random.bits(key, (2, 2), "uint32"),
    "permutation": lambda key: jax.random.permutation(key, 12),
    "scalar": lambda key: jax.random.bernoulli(key),
}


@pytest.mark.parametrize("draw", DRAWS.values(), ids=DRAWS.keys())
@given(seed=st.integers(0, 2**32 - 1))
def test_same_numbers_as_jax(draw, seed):
    key = jax.random.key(seed)
    np.testing.assert_array_equal(draw(unroll(key)), draw(key))


def test_same_numbers_of_64_bits():
    with jax.enable_x64(True):
        key = jax.random.key(3)
        np.testing.assert_array_equal(jax.random.bits(unroll(key), (5,)), jax.random.bits(key, (5,)))
        np.testing.assert_array_equal(jax.random.uniform(unroll(key), (5,)), jax.random.uniform(key, (5,)))


def test_same_numbers_under_vmap_and_scan():
    keys = jax.random.split(jax.random.key(8), 4)

    def walk(key):
        def step(key, _):
            key, now = jax.random.split(key)
            return key, jax.random.normal(now, (2,))

        return jax.lax.scan(step, key, None, length=6)[1]

    np.testing.assert_array_equal(jax.jit(jax.vmap(walk))(unroll(keys)), jax.vmap(walk)(keys))
    assert jax.random.key_data(unroll(keys)).shape == (4, 2)


def test_other_generators_are_left_alone():
    key = jax.random.key(1, impl="rbg")
    assert jax.random.key_impl(unroll(key)) == "rbg"
    assert unroll(unroll(jax.random.key(0))).dtype == unroll(jax.random.key(0)).dtype


def test_seeded_directly():
    """Keys made by the generator itself equal JAX's keys of the same seed."""
    implementation = jax.random.key_impl(unroll(jax.random.key(0)))
    own = jax.random.key(1234567, impl=implementation)
    np.testing.assert_array_equal(jax.random.key_data(own), jax.random.key_data(jax.random.key(1234567)))
    assert jnp.shape(own) == ()
