"""The torso for vectors: fully connected layers (Sec. 5.1)."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.networks.convolution import Precision
from upslope.networks.numpy_acting import Features, Layer, fully_connected
from upslope.networks.numpy_torsos import NumpyMLP
from upslope.networks.torso import ACTIVATIONS, AbstractTorso, Activation, Hidden, Scale, Shape
from upslope.types import Key


class MLP(AbstractTorso):
    """Inputs times a fixed scale, then fully connected layers.

    Attributes:
        layers: the layers in order.
    """

    twin: ClassVar[type[NumpyMLP]] = NumpyMLP
    takes_turns: ClassVar[bool] = False

    layers: tuple[eqx.nn.Linear, ...]
    scale: Scale = eqx.field(static=True)
    activation: Activation = eqx.field(static=True)

    def __init__(
        self, key: Key, inputs: int, hidden: Hidden, scale: Scale | None = None, activation: Activation = "relu"
    ):
        widths = (inputs, *hidden)
        keys = jax.random.split(key, len(hidden))
        self.layers = tuple(eqx.nn.Linear(n, m, key=k) for n, m, k in zip(widths[:-1], hidden, keys, strict=True))
        self.scale = scale if scale is not None else (1.0,)
        self.activation = activation

    @classmethod
    def fresh(cls, key: Key, shape: Shape, hidden: Hidden, scale: Scale | None, activation: Activation) -> "MLP":
        return cls(key, shape[0], hidden, scale, activation)

    @property
    def hidden(self) -> Hidden:
        return tuple(layer.weight.shape[0] for layer in self.layers)

    def __call__(self, inputs: Float[Array, "inputs"]) -> Float[Array, "features"]:
        features = inputs * jnp.asarray(self.scale, inputs.dtype)
        for layer in self.layers:
            features = ACTIVATIONS[self.activation](layer(features))
        return features

    def numpy_features(self) -> Features:
        return fully_connected([numpy_layer(layer) for layer in self.layers], self.scale, self.activation)

    def with_precision(self, precision: Precision) -> "MLP":
        del precision
        return self


def numpy_layer(layer: Any) -> Layer:
    """Weights and biases of a layer or head as NumPy arrays."""
    return np.asarray(layer.weight), np.asarray(layer.bias)
