"""The interface of a torso: the layers from an observation to the features that all heads share."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.networks.convolution import Precision
from upslope.networks.numpy_acting import Features
from upslope.networks.numpy_torsos import AbstractNumpyTorso
from upslope.types import Key, Observation

Hidden = tuple[int, ...]
Scale = tuple[float, ...]
Shape = tuple[int, ...]
Activation = Literal["relu", "tanh"]

ACTIVATIONS: dict[str, Callable] = {"relu": jax.nn.relu, "tanh": jnp.tanh}


class AbstractTorso(eqx.Module):
    """Features of one observation; map over batches at the call site.

    Attributes:
        twin: the NumPy version of the torso, built from the tensors of a file.
        takes_turns: whether several networks with different weights are faster one after the other than in a batch on
            CPUs. This is so for convolutions: in a batch they become grouped convolutions.
        scale: a factor for each input, or one for all.
        activation: the activation after each layer.
    """

    twin: eqx.AbstractClassVar[type[AbstractNumpyTorso]]
    takes_turns: eqx.AbstractClassVar[bool]

    scale: eqx.AbstractVar[Scale]
    activation: eqx.AbstractVar[Activation]

    @classmethod
    @abstractmethod
    def fresh(
        cls, key: Key, shape: Shape, hidden: Hidden, scale: Scale | None, activation: Activation
    ) -> "AbstractTorso":
        """A torso with random weights for observations of a shape."""

    @property
    @abstractmethod
    def hidden(self) -> Hidden:
        """Widths of the fully connected layers."""

    @abstractmethod
    def __call__(self, inputs: Observation) -> Float[Array, "features"]:
        """The features of one observation."""

    @abstractmethod
    def numpy_features(self) -> Features:
        """The torso as a NumPy function of a batch, for acting on the host."""

    @abstractmethod
    def with_precision(self, precision: Precision) -> "AbstractTorso":
        """The same torso with convolutions (if any) of this precision."""
