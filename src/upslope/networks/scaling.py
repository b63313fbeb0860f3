"""Normalised observations and scaled returns: what lets one set of step sizes fit the numbers of every family."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float


class Scaling(eqx.Module):
    """Fixed numbers around a network, measured on random steps. They take no gradient.

    Attributes:
        mean: of each component of the observations, or of each channel of images.
        deviation: likewise; what the difference from the mean is divided by.
        unit: the return that counts as one inside the network. V, Q and A outside it are in units of the raw return.
        level: the V for which the network says 0, in units of the raw return.
    """

    mean: Float[Array, "*batch inputs"]
    deviation: Float[Array, "*batch inputs"]
    unit: Float[Array, "*batch"]
    level: Float[Array, "*batch"]

    def normalise(self, obs: Float[Array, "*obs"]) -> Float[Array, "*obs"]:
        """The observation as the network sees it."""
        return (obs - jax.lax.stop_gradient(self.mean)) / jax.lax.stop_gradient(self.deviation)

    @property
    def return_unit(self) -> Float[Array, ""]:
        """`unit` as a constant."""
        return jax.lax.stop_gradient(self.unit)

    def value(self, output: Float[Array, ""]) -> Float[Array, ""]:
        """V in units of the raw return."""
        return jax.lax.stop_gradient(self.level) + self.return_unit * output

    def numpy(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviation as NumPy arrays, for acting on the host."""
        return np.asarray(self.mean), np.asarray(self.deviation)


def no_scaling(inputs: int) -> Scaling:
    """Observations and returns as they are."""
    zeros = jax.numpy.zeros(inputs)
    return Scaling(zeros, zeros + 1, jax.numpy.ones(()), jax.numpy.zeros(()))
