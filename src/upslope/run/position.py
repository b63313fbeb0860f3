"""The position of a run, as a PyTree and as named arrays: everything it needs to continue as if never stopped."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from upslope.run.randomness import unroll


class Position(NamedTuple):
    """The position of a run.

    Attributes:
        states: of all learners ``[learners, ...]``; None after a run whose states are not kept.
        totals: sums of the metrics since the last mark ``[learners, ...]``; None like the states.
        update: steps taken.
        reports: at each mark reached ``[learners, marks, ...]``.
        metrics: means up to each mark ``[learners, marks, ...]``.
        times: when each mark was reached, in seconds of the Unix clock ``[marks]``.
        seconds: running time up to each mark ``[marks]``, without the time that the run was stopped.
        elapsed: running time so far.
    """

    states: Any
    totals: Any
    update: int
    reports: Any
    metrics: Any
    times: np.ndarray
    seconds: np.ndarray
    elapsed: np.ndarray


def to_arrays(position: Position) -> dict[str, np.ndarray]:
    """All arrays of a position by name; random keys as their words."""
    return {name: to_numpy(leaf) for name, leaf in _by_name(_tree(position))}


def from_arrays(update: int, arrays: dict[str, np.ndarray], skeleton: Position) -> Position:
    """A position from the arrays of a file.

    Args:
        update: steps taken.
        arrays: from `to_arrays`; older files have no ``seconds``, and count stops as running time.
        skeleton: the shapes that the run needs, its reports and metrics without the axis of marks.

    Raises:
        ValueError: other arrays than the run has, or other shapes or types.
    """
    marks = len(arrays["times"])
    if "seconds" not in arrays:
        seconds = arrays["times"] - arrays["times"][:1]
        arrays = {**arrays, "seconds": seconds, "elapsed": np.asarray(seconds[-1:].sum())}
    if not any(name.startswith("states/") for name in arrays):
        skeleton = skeleton._replace(states=None, totals=None)

    def along_marks(leaf: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((leaf.shape[0], marks, *leaf.shape[1:]), leaf.dtype)

    tree = _tree(
        skeleton._replace(
            reports=jax.tree.map(along_marks, skeleton.reports),
            metrics=jax.tree.map(along_marks, skeleton.metrics),
            times=np.zeros(marks),
            seconds=np.zeros(marks),
            elapsed=np.zeros(()),
        )
    )
    named = _by_name(tree)
    if sorted(name for name, _ in named) != sorted(arrays):
        raise ValueError("other arrays than the learners have")
    leaves = [_restore(name, arrays[name], leaf) for name, leaf in named]
    return Position(update=update, **jax.tree.unflatten(jax.tree.structure(tree), leaves))


def to_numpy(leaf: Any) -> np.ndarray:
    """A leaf as a NumPy array; a random key as its words."""
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _tree(position: Position) -> dict[str, Any]:
    entries = position._asdict()
    del entries["update"]
    return entries


def _by_name(tree: Any) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]


def _is_key(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _restore(name: str, array: np.ndarray, leaf: Any) -> Any:
    if _is_key(leaf):
        restored = unroll(jax.random.wrap_key_data(jnp.asarray(array)))
        if restored.shape != leaf.shape or restored.dtype != leaf.dtype:
            raise ValueError(f"{name} holds keys of another shape or generator")
        return restored
    if array.shape != leaf.shape or array.dtype != leaf.dtype:
        raise ValueError(f"{name} is {array.dtype}{list(array.shape)}, not {leaf.dtype}{list(leaf.shape)}")
    return array
