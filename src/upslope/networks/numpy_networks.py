"""Our networks in plain numpy: on the host one acts at every step, and a compiled call costs ten times more."""

from collections.abc import Callable
from typing import Any

import numpy as np

from upslope.networks.actor_critic import Actor
from upslope.networks.dueling import MLP, ConvolutionalTorso, DuelingQ, QNetwork
from upslope.networks.numpy_convolution import convolve

#: Functions of an array, and of the array that their result goes into.
_ACTIVATIONS: dict[str, Callable] = {"relu": lambda x, out=None: np.maximum(x, 0.0, out=out), "tanh": np.tanh}


def has_numpy_form(function: Any) -> bool:
    """Whether `numpy_batch` takes it: a `DuelingQ` (its Q), its ``advantage``, a `QNetwork` or an `Actor`."""
    owner, method = _owner_and_method(function)
    known = isinstance(owner, DuelingQ | QNetwork | Actor) and isinstance(owner.torso, MLP | ConvolutionalTorso)
    return known and (method == "__call__" or (isinstance(owner, DuelingQ) and method == "advantage"))


def numpy_batch(function: Any, *, order_only: bool = False) -> Callable[[np.ndarray], np.ndarray]:
    """The numpy form of a network, or of a method of one, for batches ``[n, *obs]``.

    Args:
        function: one that `has_numpy_form`, unbatched.
        order_only: only the order of the actions counts: of Q the raw A will do, which orders them alike.
    """
    owner, method = _owner_and_method(function)
    torso = _torso(owner.torso)
    if isinstance(owner, DuelingQ):
        advantage = _linear(owner.advantage_head)
        if method == "advantage" or order_only:
            return lambda obs: advantage(torso(obs))
        both = _linear(owner.value_head, owner.advantage_head)
        return lambda obs: _dueling(both(torso(obs)))
    head = _linear(owner.head)
    if isinstance(owner, QNetwork):
        return lambda obs: head(torso(obs))
    return lambda obs: np.tanh(head(torso(obs)))


def _owner_and_method(function: Any) -> tuple[Any, str]:
    owner = getattr(function, "__self__", function)
    return owner, getattr(getattr(function, "__func__", None), "__name__", "__call__")


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
    """The hidden layers: from observations ``[n, inputs]`` to features and a last row of ones ``[features + 1, n]``.

    At ten environments a step costs as many microseconds as there are calls of NumPy, so scales and biases are parts of
    the weights, biases as the weights of ones; and features are rows, so that those before the ones lie together.
    """
    first, *others = torso.layers
    scale = np.broadcast_to(np.asarray(torso.scale, np.float32), first.weight.shape[1])
    weights = [_weights(first) * np.append(scale, np.float32(1.0)), *map(_weights, others)]
    activate = _ACTIVATIONS[torso.activation]
    inputs: list[np.ndarray] = []
    rows: list[np.ndarray] = []

    def call(obs: np.ndarray) -> np.ndarray:
        if not inputs or inputs[0].shape[1] != len(obs):
            widths = (weights[0].shape[1], *(len(weight) + 1 for weight in weights))
            inputs[:] = [np.ones((width, len(obs)), np.float32) for width in widths]
            rows[:] = [array[:-1] for array in inputs]
        rows[0][:] = obs.T
        for weight, features, outputs in zip(weights, inputs, rows[1:], strict=False):
            activate(np.dot(weight, features, outputs), outputs)
        return inputs[-1]

    return call


def _linear(*layers: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Layers on the same features, which a row of ones follows, side by side in one product ``[n, outputs]``."""
    weight = _weights(*layers)
    return lambda features: np.dot(weight, features).T


def _weights(*layers: Any) -> np.ndarray:
    """The layers' weights ``[outputs, inputs + 1]``, one below the other, the last column their biases."""
    rows = [np.concatenate([np.asarray(layer.weight), np.asarray(layer.bias)[:, None]], axis=1) for layer in layers]
    return np.concatenate(rows)
