"""Torsos in NumPy, built from the tensors of a file, that compute Φ in simulator processes. Needs no JAX."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from upslope.errors import UpslopeError
from upslope.networks.numpy_convolution import CHANNELS, convolve

Tensors = Mapping[str, np.ndarray]
Shape = tuple[int, ...]


class AbstractNumpyTorso(ABC):
    """Features of observations, in double precision.

    Attributes:
        rank: the number of axes of the observations that the torso accepts.
    """

    rank: ClassVar[int]

    @staticmethod
    @abstractmethod
    def tensor_shapes(observation_shape: Shape, hidden: Shape) -> dict[str, Shape]:
        """The names and shapes of the torso's tensors in a file."""

    @abstractmethod
    def __init__(self, tensors: Tensors, hidden: Shape, scale: Sequence[float], activation: str):
        """Takes all tensors of a file, widths of the hidden layers, factors of the inputs, and the activation."""

    @abstractmethod
    def one(self, obs: np.ndarray) -> Float[np.ndarray, "features"]:
        """Features of one observation."""

    @abstractmethod
    def batch(self, obs: np.ndarray) -> Float[np.ndarray, "n features"]:
        """Features of observations ``[n, *obs]``."""


class NumpyMLP(AbstractNumpyTorso):
    """Fully connected layers on vectors."""

    rank = 1

    @staticmethod
    def tensor_shapes(observation_shape: Shape, hidden: Shape) -> dict[str, Shape]:
        return _layer_shapes("torso.layers", observation_shape[0], hidden)

    def __init__(self, tensors: Tensors, hidden: Shape, scale: Sequence[float], activation: str):
        self._layers = _layers(tensors, "torso.layers", len(hidden))
        weight, bias = self._layers[0]
        # The first layer's weights include the fixed scale of the inputs.
        self._layers[0] = (weight * np.asarray(scale), bias)
        self._activate = _ACTIVATIONS[activation]

    def one(self, obs: np.ndarray) -> Float[np.ndarray, "features"]:
        features = obs
        # Like `batch` for one vector: without the batch axis NumPy calls take half the time.
        for weight, bias in self._layers:
            features = weight.dot(features)
            features += bias
            self._activate(features, features)
        return features

    def batch(self, obs: np.ndarray) -> Float[np.ndarray, "n features"]:
        return _dense(np.asarray(obs, np.float64), self._layers, self._activate)


class NumpyConvolutional(AbstractNumpyTorso):
    """Layers of 3 × 3 kernels on images ``[height, width, channels]``, then fully connected layers."""

    rank = 3

    @staticmethod
    def tensor_shapes(observation_shape: Shape, hidden: Shape) -> dict[str, Shape]:
        height, width, inputs = observation_shape
        channels = enumerate(pairwise((inputs, *CHANNELS)))
        shapes: dict[str, Shape] = {f"torso.kernels.{i}": (3, 3, n, m) for i, (n, m) in channels}
        shapes |= {f"torso.biases.{i}": (m,) for i, m in enumerate(CHANNELS)}
        return shapes | _layer_shapes("torso.dense.layers", height * width * CHANNELS[-1], hidden)

    def __init__(self, tensors: Tensors, hidden: Shape, scale: Sequence[float], activation: str):
        names = [(f"torso.kernels.{i}", f"torso.biases.{i}") for i in range(len(CHANNELS))]
        self._kernels = [(_double(tensors[kernel]), _double(tensors[bias])) for kernel, bias in names]
        kernel, bias = self._kernels[0]
        self._kernels[0] = (kernel * np.asarray(scale)[:, None], bias)
        self._layers = _layers(tensors, "torso.dense.layers", len(hidden))
        self._activate = _ACTIVATIONS[activation]

    def one(self, obs: np.ndarray) -> Float[np.ndarray, "features"]:
        return self.batch(np.asarray(obs)[None])[0]

    def batch(self, obs: np.ndarray) -> Float[np.ndarray, "n features"]:
        images = np.asarray(obs, np.float64)
        for kernel, bias in self._kernels:
            images = convolve(images, kernel)
            images += bias
            self._activate(images, images)
        return _dense(images.reshape(len(images), -1), self._layers, self._activate)


#: Torsos by the rank of the observations. Register the NumPy version of a new torso here.
NUMPY_TORSOS: dict[int, type[AbstractNumpyTorso]] = {torso.rank: torso for torso in (NumpyMLP, NumpyConvolutional)}


def numpy_torso_for(observation_shape: Shape) -> type[AbstractNumpyTorso]:
    """The torso for observations of a shape.

    Raises:
        UpslopeError: there is none.
    """
    try:
        return NUMPY_TORSOS[len(observation_shape)]
    except KeyError as error:
        raise UpslopeError(
            f"No network takes observations of shape {observation_shape}: use vectors, or images with channels."
        ) from error


def _relu(features: np.ndarray, out: np.ndarray) -> np.ndarray:
    return np.maximum(features, 0.0, out=out)


_ACTIVATIONS: dict[str, Callable] = {"relu": _relu, "tanh": np.tanh}


def _layer_shapes(prefix: str, inputs: int, hidden: Shape) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    for i, (n, m) in enumerate(pairwise((inputs, *hidden))):
        shapes |= {f"{prefix}.{i}.weight": (m, n), f"{prefix}.{i}.bias": (m,)}
    return shapes


def _layers(tensors: Tensors, prefix: str, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    names = [(f"{prefix}.{i}.weight", f"{prefix}.{i}.bias") for i in range(count)]
    return [(_double(tensors[weight]), _double(tensors[bias])) for weight, bias in names]


def _double(tensor: np.ndarray) -> np.ndarray:
    return tensor.astype(np.float64)


def _dense(features: np.ndarray, layers: list[tuple[np.ndarray, np.ndarray]], activate: Callable) -> np.ndarray:
    for weight, bias in layers:
        features = features @ weight.T
        features += bias
        activate(features, features)
    return features
