"""Hand-made experience of finite tasks, and a network whose ReLUs are not at their kinks."""

import jax
import jax.numpy as jnp

from upslope.meta_training.posteriors.finite import Steps


def steps_of(*rows) -> Steps:
    """Steps from rows of state, action, reward, discount, successor, share."""
    columns = [jnp.asarray(column) for column in zip(*rows, strict=True)]
    ints = (0, 1, 4)
    return Steps(*(c.astype(jnp.int32) if i in ints else c.astype(jnp.float32) for i, c in enumerate(columns)))


def moved(network, size=0.05):
    """The network with noise on every weight: with zero biases, ReLUs are at their kinks where a map is empty."""
    leaves, structure = jax.tree.flatten(network)
    keys = jax.random.split(jax.random.key(7), len(leaves))
    noisy = [leaf + size * jax.random.normal(key, leaf.shape) for leaf, key in zip(leaves, keys, strict=True)]
    return jax.tree.unflatten(structure, noisy)
