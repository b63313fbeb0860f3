"""Finite differences, to check gradients that flow through gradients."""

from collections.abc import Callable

import jax
import numpy as np


def assert_gradient(objective: Callable, params, gradient, *, directions=3, size=1e-5, rtol=1e-6):
    """``gradient`` against central differences of ``objective`` along random directions; needs float64."""
    leaves, structure = jax.tree.flatten(params)
    for seed in range(directions):
        rng = np.random.default_rng(seed)
        along = [rng.normal(size=leaf.shape) for leaf in leaves]

        def moved(step, along=along):
            return jax.tree.unflatten(structure, [p + step * d for p, d in zip(leaves, along, strict=True)])

        difference = (objective(moved(size)) - objective(moved(-size))) / (2 * size)
        slope = sum(np.vdot(g, d) for g, d in zip(jax.tree.leaves(gradient), along, strict=True))
        assert abs(float(slope)) > 1e-9, "the slope must not be zero, or nothing is compared"
        np.testing.assert_allclose(float(slope), float(difference), rtol=rtol)
