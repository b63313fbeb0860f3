"""Potentials from networks. All arms of a comparison have the same form and share one compiled program."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.networks.dueling import AbstractDueling
from upslope.types import Observation, Scalar

Tree = TypeVar("Tree")


class MeanPotential(eqx.Module):
    """Φ(s) = bias + scale · mean over k of V_k(s).

    Bias 0 and scale 0 mean no shaping; bias c and scale 0 a constant potential; K = 1 a prior or an oracle; K > 1 an
    ensemble.

    Attributes:
        networks: K dueling networks as one stacked PyTree ``[K, ...]``.
        scale: the factor of the mean.
        bias: added to the scaled mean, in units of return.
    """

    networks: AbstractDueling
    scale: Float[Array, "*batch"]
    bias: Float[Array, "*batch"]

    def __call__(self, obs: Observation) -> Scalar:
        values = jax.vmap(lambda network: network.value(obs))(self.networks)
        return self.bias + self.scale * jnp.mean(values)


def mean_potential(networks: AbstractDueling, *, scale: float = 1.0, bias: float = 0.0) -> MeanPotential:
    """The mean of K stacked networks' V heads, scaled and shifted."""
    return MeanPotential(networks, jnp.asarray(scale, jnp.float32), jnp.asarray(bias, jnp.float32))


def constant_potential(like: AbstractDueling, level: float) -> MeanPotential:
    """Φ(s) = level, in the same form as `mean_potential` over ``like``, so that it shares the compiled program."""
    return mean_potential(like, scale=0.0, bias=level)


def stack(trees: list[Tree]) -> Tree:
    """Stacks PyTrees of the same structure along a new leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
