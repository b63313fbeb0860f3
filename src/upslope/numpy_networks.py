"""Our networks in plain numpy: on the host one acts at every step, and a compiled call costs ten times more."""

from collections.abc import Callable
from typing import Any

import numpy as np

from upslope.networks import MLP, Actor, ConvolutionalTorso, DuelingQ, QNetwork
from upslope.numpy_convolution import convolve

_ACTIVATIONS: dict[str, Callable] = {"relu": lambda x: np.maximum(x, 0.0), "tanh": np.tanh}


def numpy_batch(function: Any) -> Callable[[np.ndarray], np.ndarray] | None:
    """The numpy form of a network, or of a method of one, for batches ``[n, *obs]``; None if there is none.

    Args:
        function: a `DuelingQ` (its Q), its ``advantage``, a `QNetwork` or an `Actor`, unbatched.
    """
    owner = getattr(function, "__self__", function)
    method = getattr(getattr(function, "__func__", None), "__name__", "__call__")
    if not isinstance(getattr(owner, "torso", None), MLP | ConvolutionalTorso):
        return None
    torso = _torso(owner.torso)
    if isinstance(owner, DuelingQ) and method in ("__call__", "advantage"):
        advantage = _linear(owner.advantage_head)
        if method == "advantage":
            return lambda obs: advantage(torso(obs))
        both = _linear(owner.value_head, owner.advantage_head)
        return lambda obs: _dueling(both(torso(obs)))
    if isinstance(owner, QNetwork) and method == "__call__":
        head = _linear(owner.head)
        return lambda obs: head(torso(obs))
    if isinstance(owner, Actor) and method == "__call__":
        head = _linear(owner.head)
        return lambda obs: np.tanh(head(torso(obs)))
    return None


def _dueling(heads: np.ndarray) -> np.ndarray:
    value, raw = heads[..., :1], heads[..., 1:]
    return value + (raw - raw.max(-1, keepdims=True))


def _torso(torso: MLP | ConvolutionalTorso) -> Callable[[np.ndarray], np.ndarray]:
    return _fully_connected(torso) if isinstance(torso, MLP) else _convolutional(torso)


def _convolutional(torso: ConvolutionalTorso) -> Callable[[np.ndarray], np.ndarray]:
    scale = np.asarray(torso.scale, np.float32)
    layers = [(np.asarray(kernel), np.asarray(bias)) for kernel, bias in zip(torso.kernels, torso.biases, strict=True)]
    activate, dense = _ACTIVATIONS[torso.activation], _fully_connected(torso.dense)

    def call(obs: np.ndarray) -> np.ndarray:
        images = obs * scale
        for kernel, bias in layers:
            images = activate(convolve(images, kernel) + bias)
        return dense(images.reshape(len(images), -1))

    return call


def _fully_connected(torso: MLP) -> Callable[[np.ndarray], np.ndarray]:
    scale = np.asarray(torso.scale, np.float32)
    layers = [_linear(layer) for layer in torso.layers]
    activate = _ACTIVATIONS[torso.activation]

    def call(obs: np.ndarray) -> np.ndarray:
        features = obs * scale
        for layer in layers:
            features = activate(layer(features))
        return features

    return call


def _linear(*layers: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Layers on the same features, side by side in one product."""
    weight = np.concatenate([np.asarray(layer.weight) for layer in layers]).T.copy()
    bias = np.concatenate([np.asarray(layer.bias) for layer in layers])
    return lambda features: features @ weight + bias
