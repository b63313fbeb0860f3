"""Torsos by observation shape. Register a new torso here, and its NumPy version in `numpy_torsos`."""

from upslope.networks.convolutional import ConvolutionalTorso
from upslope.networks.mlp import MLP
from upslope.networks.numpy_torsos import numpy_torso_for
from upslope.networks.torso import AbstractTorso, Activation, Hidden, Scale, Shape
from upslope.types import Key

TORSOS: dict[type, type[AbstractTorso]] = {torso.twin: torso for torso in (MLP, ConvolutionalTorso)}


def torso_class(observation_shape: Shape) -> type[AbstractTorso]:
    """The torso for observations of a shape: vectors, or images ``(height, width, channels)``.

    Raises:
        UpslopeError: there is none.
    """
    return TORSOS[numpy_torso_for(observation_shape)]


def fresh_torso(
    key: Key, inputs: int | Shape, hidden: Hidden, scale: Scale | None, activation: Activation = "relu"
) -> AbstractTorso:
    """A torso with random weights for observations of a shape, or for vectors of a length.

    Raises:
        UpslopeError: there is no torso for this shape.
    """
    shape = (inputs,) if isinstance(inputs, int) else inputs
    return torso_class(shape).fresh(key, shape, hidden, scale, activation)
