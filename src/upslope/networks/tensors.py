"""Networks as named tensors, for files. The names are the paths of the fields."""

from collections.abc import Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Network = TypeVar("Network")


def to_tensors(network: Any) -> dict[str, np.ndarray]:
    """All arrays of a network by name, such as ``torso.layers.0.weight``."""
    return {name: np.asarray(leaf) for name, leaf in _named_leaves(network)}


def from_tensors(skeleton: Network, tensors: Mapping[str, np.ndarray]) -> Network:
    """A network with these tensors.

    Args:
        skeleton: a network of the same structure, or its shapes (`equinox.filter_eval_shape`).
        tensors: by name.

    Raises:
        ValueError: names, shapes or types differ from the skeleton's.
    """
    named = _named_leaves(skeleton)
    if sorted(name for name, _ in named) != sorted(tensors):
        raise ValueError("it holds other tensors than its header announces")
    for name, leaf in named:
        tensor = tensors[name]
        if tensor.shape != leaf.shape or tensor.dtype != leaf.dtype:
            raise ValueError(
                f"{name} is {tensor.dtype}{list(tensor.shape)}, but the header announces {leaf.dtype}{list(leaf.shape)}"
            )
    return jax.tree.unflatten(jax.tree.structure(skeleton), [jnp.asarray(tensors[name]) for name, _ in named])


def _named_leaves(network: Any) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(network)
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in leaves]
