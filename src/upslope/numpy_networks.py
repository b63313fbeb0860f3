"""Our networks in plain numpy: on the host one acts at every step, and a compiled call costs ten times more."""

from collections.abc import Callable
from typing import Any

import numpy as np

from upslope.networks import MLP, Actor, DuelingQ, QNetwork

_ACTIVATIONS: dict[str, Callable] = {"relu": lambda x: np.maximum(x, 0.0), "tanh": np.tanh}


def numpy_batch(function: Any) -> Callable[[np.ndarray], np.ndarray] | None:
    """The numpy form of a network, or of a method of one, for batches ``[n, inputs]``; None if there is none.

    Args:
        function: a `DuelingQ` (its Q), its ``advantage``, a `QNetwork` or an `Actor`, unbatched.
    """
    owner = getattr(function, "__self__", function)
    method = getattr(getattr(function, "__func__", None), "__name__", "__call__")
    if not isinstance(getattr(owner, "torso", None), MLP):
        return None
    torso = _torso(owner.torso)
    if isinstance(owner, DuelingQ) and method in ("__call__", "advantage"):
        advantage = _linear(owner.advantage_head)
        if method == "advantage":
            return lambda obs: advantage(torso(obs))
        value = _linear(owner.value_head)
        return lambda obs: _dueling(value, advantage, torso(obs))
    if isinstance(owner, QNetwork) and method == "__call__":
        head = _linear(owner.head)
        return lambda obs: head(torso(obs))
    if isinstance(owner, Actor) and method == "__call__":
        head = _linear(owner.head)
        return lambda obs: np.tanh(head(torso(obs)))
    return None


def _dueling(value: Callable, advantage: Callable, features: np.ndarray) -> np.ndarray:
    raw = advantage(features)
    return value(features) + (raw - raw.max(-1, keepdims=True))


def _torso(torso: MLP) -> Callable[[np.ndarray], np.ndarray]:
    scale = np.asarray(torso.scale, np.float32)
    layers = [_linear(layer) for layer in torso.layers]
    activate = _ACTIVATIONS[torso.activation]

    def call(obs: np.ndarray) -> np.ndarray:
        features = obs * scale
        for layer in layers:
            features = activate(layer(features))
        return features

    return call


def _linear(layer: Any) -> Callable[[np.ndarray], np.ndarray]:
    weight, bias = np.asarray(layer.weight).T.copy(), np.asarray(layer.bias)
    return lambda features: features @ weight + bias
