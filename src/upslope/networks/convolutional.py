"""The torso for images and maps: convolutions, then fully connected layers (Sec. 5.2)."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.networks.convolution import Precision, convolve, fastest_form
from upslope.networks.convolution_forms import Convolution
from upslope.networks.mlp import MLP
from upslope.networks.numpy_acting import Features, convolutional
from upslope.networks.numpy_convolution import CHANNELS
from upslope.networks.numpy_torsos import NumpyConvolutional
from upslope.networks.torso import ACTIVATIONS, AbstractTorso, Activation, Hidden, Scale, Shape
from upslope.types import Key


class ConvolutionalTorso(AbstractTorso):
    """Layers of 3 × 3 kernels, then fully connected layers: in the paper four layers of 32 kernels, then two.

    Attributes:
        kernels: one for each layer, ``[3, 3, inputs, outputs]``. The padding is SAME: without it small maps vanish.
        biases: one array for each layer.
        dense: the fully connected layers, on the flattened maps.
        convolution: the form of the convolution. All forms give the same results, and files do not store it.
        precision: of the convolution's factors; files do not store it either.
    """

    twin: ClassVar[type[NumpyConvolutional]] = NumpyConvolutional
    takes_turns: ClassVar[bool] = True

    kernels: tuple[Float[Array, "..."], ...]
    biases: tuple[Float[Array, "..."], ...]
    dense: MLP
    scale: Scale = eqx.field(static=True)
    activation: Activation = eqx.field(static=True)
    convolution: Convolution = eqx.field(static=True)
    precision: Precision = eqx.field(static=True, default="float32")

    @classmethod
    def fresh(
        cls, key: Key, shape: Shape, hidden: Hidden, scale: Scale | None, activation: Activation
    ) -> "ConvolutionalTorso":
        return convolutional_torso(key, shape, hidden, scale, activation)

    @property
    def hidden(self) -> Hidden:
        return self.dense.hidden

    def __call__(self, inputs: Float[Array, "height width channels"]) -> Float[Array, "features"]:
        images = inputs * jnp.asarray(self.scale, inputs.dtype)
        for kernel, bias in zip(self.kernels, self.biases, strict=True):
            maps = convolve(images, kernel, self.convolution, self.precision) + bias
            images = ACTIVATIONS[self.activation](maps)
        return self.dense(images.ravel())

    def numpy_features(self) -> Features:
        layers = [
            (np.asarray(kernel), np.asarray(bias)) for kernel, bias in zip(self.kernels, self.biases, strict=True)
        ]
        return convolutional(layers, self.scale, self.activation, self.dense.numpy_features())

    def with_precision(self, precision: Precision) -> "ConvolutionalTorso":
        return replace(self, precision=precision)


def convolutional_torso(
    key: Key,
    shape: Shape,
    hidden: Hidden = (128, 128),
    scale: Scale | None = None,
    activation: Activation = "relu",
    *,
    channels: Hidden = CHANNELS,
) -> ConvolutionalTorso:
    """A fresh torso for maps of ``(height, width, channels)``, with the fastest form of the convolution."""
    height, width, inputs = shape
    keys = jax.random.split(key, len(channels) + 1)
    # He initialisation: with the default scale of fully connected layers, activations would shrink in each layer.
    kernel = jax.nn.initializers.he_normal(in_axis=(0, 1, 2))
    pairs = zip(keys, (inputs, *channels[:-1]), channels, strict=False)
    return ConvolutionalTorso(
        kernels=tuple(kernel(k, (3, 3, n, m)) for k, n, m in pairs),
        biases=tuple(jnp.zeros(m) for m in channels),
        dense=MLP(keys[-1], height * width * channels[-1], hidden, activation=activation),
        scale=scale if scale is not None else (1.0,),
        activation=activation,
        convolution=fastest_form(),
    )
