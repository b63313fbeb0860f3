"""Networks in NumPy for acting on the host, in float32: a compiled call at each step takes ten times as long.

Needs no JAX. Features have a last row of ones, so that biases are part of the weights: with ten environments a step
takes about one microsecond per NumPy call.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from upslope.networks.numpy_convolution import convolve

#: Weights ``[outputs, inputs]`` and biases ``[outputs]`` of one layer.
Layer = tuple[np.ndarray, np.ndarray]

#: A function from observations ``[n, *obs]`` to features with a last row of ones ``[features + 1, n]``.
Features = Callable[[np.ndarray], Float[np.ndarray, "rows n"]]

#: Functions of an array and an output array.
_ACTIVATIONS: dict[str, Callable] = {"relu": lambda x, out=None: np.maximum(x, 0.0, out=out), "tanh": np.tanh}


def fully_connected(layers: Sequence[Layer], scale: Sequence[float], activation: str) -> Features:
    """Fully connected hidden layers.

    Args:
        layers: the layers in order.
        scale: a factor for each input, or one for all.
        activation: the activation after each layer.
    """
    first, *others = [affine(layer) for layer in layers]
    factors = np.broadcast_to(np.asarray(scale, np.float32), first.shape[1] - 1)
    weights = [first * np.append(factors, np.float32(1.0)), *others]
    activate = _ACTIVATIONS[activation]
    inputs: list[np.ndarray] = []
    rows: list[np.ndarray] = []

    def features(obs: np.ndarray) -> np.ndarray:
        if not inputs or inputs[0].shape[1] != len(obs):
            widths = (weights[0].shape[1], *(len(weight) + 1 for weight in weights))
            inputs[:] = [np.ones((width, len(obs)), np.float32) for width in widths]
            rows[:] = [array[:-1] for array in inputs]
        rows[0][:] = obs.T
        for weight, given, results in zip(weights, inputs, rows[1:], strict=False):
            activate(np.dot(weight, given, results), results)
        return inputs[-1]

    return features


def convolutional(layers: Sequence[Layer], scale: Sequence[float], activation: str, dense: Features) -> Features:
    """Convolutions, then fully connected layers.

    Args:
        layers: kernels ``[3, 3, inputs, outputs]`` and biases of the convolutions, in order.
        scale: a factor for each channel, or one for all.
        activation: the activation after each convolution.
        dense: the fully connected layers, on the flattened maps.
    """
    factors, activate = np.asarray(scale, np.float32), _ACTIVATIONS[activation]

    def features(obs: np.ndarray) -> np.ndarray:
        images = obs * factors
        for kernel, bias in layers:
            images = activate(convolve(images, kernel) + bias)
        return dense(images.reshape(len(images), -1))

    return features


def affine(*layers: Layer) -> Float[np.ndarray, "outputs inputs_and_one"]:
    """The weights of layers on the same features, stacked row by row. The last column holds the biases."""
    return np.concatenate([np.concatenate([weight, bias[:, None]], axis=1) for weight, bias in layers])
