"""Comparisons of whole PyTrees."""

import jax
import numpy as np


def assert_trees_close(ours, theirs, *, rtol=1e-5, atol=1e-6):
    """The same structure, and the same numbers up to rounding."""
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for mine, yours in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(np.asarray(mine), np.asarray(yours), rtol=rtol, atol=atol)


def assert_trees_identical(ours, theirs):
    """The same structure, types and bits."""
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for mine, yours in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert mine.dtype == yours.dtype
        np.testing.assert_array_equal(_plain(mine), _plain(yours))


def largest(tree) -> float:
    """The largest absolute number in a PyTree."""
    return max(float(np.max(np.abs(np.asarray(leaf)))) for leaf in jax.tree.leaves(tree))


def _plain(leaf):
    is_key = jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)
