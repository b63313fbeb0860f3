"""Shaping from a user's potential: a prior, or a function of one observation."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.errors import UpslopeError
from upslope.learners.shaping import Shaping, potential_based
from upslope.priors.prior import Prior
from upslope.tasks.family import AbstractFamily
from upslope.types import Observation, Potential


def shaping_by(potential: Potential | Prior | None, family: AbstractFamily) -> Shaping | None:
    """Shaping with a potential, after a check that it fits the family's tasks; None without a potential.

    Raises:
        UpslopeError: the prior belongs to other tasks, or the function is not a potential (see `check_potential`).
    """
    if potential is None:
        return None
    if isinstance(potential, Prior):
        potential.check(family)
        return potential_based(potential.network.value)
    return potential_based(check_potential(potential, family))


def check_potential(potential: Potential, family: AbstractFamily) -> Any:
    """The potential as a function that JAX can trace, after a test on one observation.

    Raises:
        UpslopeError: it does not return a single finite number, or JAX can't trace it.
    """
    obs: Observation = jnp.zeros(family.observation_shape)
    try:
        shape = jax.eval_shape(potential, obs)
    except Exception as error:
        why, _, _ = str(error).partition("\n")  # JAX's messages are pages long
        raise UpslopeError(
            f"The potential failed on one observation of shape {family.observation_shape} "
            f"({type(error).__name__}: {why}): write it with jax.numpy, for one observation."
        ) from error
    if getattr(shape, "shape", None) != ():
        raise UpslopeError(
            f"The potential returned {getattr(shape, 'shape', type(shape))} for one observation: "
            "return a single number."
        )
    if not bool(jnp.isfinite(potential(obs))):
        raise UpslopeError("The potential is not finite at the zero observation: make it finite everywhere.")
    return potential if isinstance(potential, eqx.Module) else jax.tree_util.Partial(potential)
