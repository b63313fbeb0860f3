"""The networks: a dueling Q-network whose V head is the potential, and what vanilla learners use.

All are plain PyTrees that act on one observation; map over batches at the call site.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.equations.losses import dueling_q
from upslope.errors import UpslopeError
from upslope.networks.convolution import PRECISIONS, Precision, convolve, fastest_form
from upslope.networks.convolution_forms import Convolution
from upslope.networks.numpy_convolution import CHANNELS
from upslope.types import Key, Observation, Scalar

Hidden = tuple[int, ...]
Scale = tuple[float, ...]
Shape = tuple[int, ...]
Activation = Literal["relu", "tanh"]

ACTIVATIONS: dict[str, Callable] = {"relu": jax.nn.relu, "tanh": jnp.tanh}


class MLP(eqx.Module):
    """Inputs times a fixed scale, then fully connected layers: the shared torso.

    Attributes:
        layers: one after the other.
        scale: of each input, or one of all.
        activation: after each layer.
    """

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

    @property
    def hidden(self) -> Hidden:
        """Widths of the fully connected layers."""
        return tuple(layer.weight.shape[0] for layer in self.layers)

    def __call__(self, inputs: Float[Array, "inputs"]) -> Float[Array, "features"]:
        features = inputs * jnp.asarray(self.scale, inputs.dtype)
        for layer in self.layers:
            features = ACTIVATIONS[self.activation](layer(features))
        return features


class ConvolutionalTorso(eqx.Module):
    """Layers of 3 × 3 kernels, then fully connected layers (Sec. 5.2: four layers of 32 kernels, and two).

    Attributes:
        kernels: of each layer ``[3, 3, inputs, outputs]``; padding is SAME, or nothing of a small map is left.
        biases: of each layer.
        dense: the fully connected layers, on the flattened maps.
        convolution: which form of the convolution; all are equal but for speed, and no part of what is saved.
        precision: of its factors; no part of what is saved either.
    """

    kernels: tuple[Float[Array, "..."], ...]
    biases: tuple[Float[Array, "..."], ...]
    dense: MLP
    scale: Scale = eqx.field(static=True)
    activation: Activation = eqx.field(static=True)
    convolution: Convolution = eqx.field(static=True)
    precision: Precision = eqx.field(static=True, default="float32")

    @property
    def hidden(self) -> Hidden:
        """Widths of the fully connected layers."""
        return self.dense.hidden

    def __call__(self, inputs: Float[Array, "height width channels"]) -> Float[Array, "features"]:
        images = inputs * jnp.asarray(self.scale, inputs.dtype)
        for kernel, bias in zip(self.kernels, self.biases, strict=True):
            maps = convolve(images, kernel, self.convolution, self.precision) + bias
            images = ACTIVATIONS[self.activation](maps)
        return self.dense(images.ravel())


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
    # He's initialisation: at the scale of fully connected layers' default a map would fade from layer to layer.
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


def torso_for(
    key: Key, inputs: int | Shape, hidden: Hidden, scale: Scale | None, activation: Activation = "relu"
) -> MLP | ConvolutionalTorso:
    """What suits the observations: fully connected for vectors, convolutional for maps ``(height, width, channels)``.

    Raises:
        UpslopeError: observations that are neither.
    """
    shape = (inputs,) if isinstance(inputs, int) else inputs
    if len(shape) == 1:
        return MLP(key, shape[0], hidden, scale, activation)
    if len(shape) == 3:
        return convolutional_torso(key, shape, hidden, scale, activation)
    raise UpslopeError(f"No network takes observations of shape {shape}: make them vectors, or maps with channels.")


class DuelingQ(eqx.Module):
    """V head and A head on one torso (Eq. 6). Its V head is the potential Φ.

    For vectors of ``inputs`` numbers the torso is fully connected (Sec. 5.1); for maps, ``inputs`` being
    ``(height, width, channels)``, it is the paper's convolutional one (Sec. 5.2).
    """

    torso: MLP | ConvolutionalTorso
    value_head: eqx.nn.Linear
    advantage_head: eqx.nn.Linear

    def __init__(
        self,
        key: Key,
        inputs: int | Shape,
        actions: int,
        hidden: Hidden = (32, 32),
        scale: Scale | None = None,
        activation: Activation = "relu",
    ):
        torso_key, value_key, advantage_key = jax.random.split(key, 3)
        self.torso = torso_for(torso_key, inputs, hidden, scale, activation)
        self.value_head = eqx.nn.Linear(hidden[-1], 1, key=value_key)
        self.advantage_head = eqx.nn.Linear(hidden[-1], actions, key=advantage_key)

    def heads(self, obs: Observation) -> tuple[Scalar, Float[Array, "actions"]]:
        """V(s) and the raw A(s, ·), from one pass through the torso."""
        return self.heads_on(self.torso(obs))

    def heads_on(self, features: Float[Array, "units"]) -> tuple[Scalar, Float[Array, "actions"]]:
        """V(s) and the raw A(s, ·), given what the torso makes of s."""
        return self.value_head(features)[0], self.advantage_head(features)

    def value(self, obs: Observation) -> Scalar:
        """V(s)."""
        return self.heads(obs)[0]

    def advantage(self, obs: Observation) -> Float[Array, "actions"]:
        """A(s, ·), raw: its level is not pinned down by Eq. 6."""
        return self.heads(obs)[1]

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        """Q(s, ·) by Eq. 6."""
        return dueling_q(*self.heads(obs))


class QNetwork(eqx.Module):
    """The vanilla Q-network of a DQN: no dueling; its torso suits the observations as `DuelingQ`'s does."""

    torso: MLP | ConvolutionalTorso
    head: eqx.nn.Linear

    def __init__(
        self, key: Key, inputs: int | Shape, actions: int, hidden: Hidden = (32, 32), scale: Scale | None = None
    ):
        torso_key, head_key = jax.random.split(key)
        self.torso = torso_for(torso_key, inputs, hidden, scale)
        self.head = eqx.nn.Linear(hidden[-1], actions, key=head_key)

    def __call__(self, obs: Observation) -> Float[Array, "actions"]:
        return self.head(self.torso(obs))


Network = TypeVar("Network", DuelingQ, QNetwork)


def with_convolutions(network: Network, precision: str) -> Network:
    """The same network with other convolutions, if it has any.

    Args:
        network: of any kind.
        precision: how many bits there are in what they multiply.

    Raises:
        UpslopeError: an unknown precision.
    """
    if precision not in PRECISIONS:
        raise UpslopeError(f"There is no precision {precision!r}: choose {', '.join(PRECISIONS)}.")
    if not isinstance(network.torso, ConvolutionalTorso):
        return network
    torso = replace(network.torso, precision=precision)
    return eqx.tree_at(lambda network: network.torso, network, torso)
