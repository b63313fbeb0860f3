"""How far a run has come, and that as named arrays: all it needs to go on as if it had never stopped."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from upslope.run.randomness import unrolled


class Position(NamedTuple):
    """How far a run has come.

    Attributes:
        states: of all learners ``[learners, ...]``; None once a run is over whose states nobody needs.
        totals: sums of the metrics since the last mark ``[learners, ...]``; None like the states.
        update: steps taken.
        reports: at each mark reached ``[learners, marks, ...]``.
        metrics: means up to each mark ``[learners, marks, ...]``.
        times: when each mark was reached, in seconds of the Unix clock ``[marks]``.
        seconds: of running up to each mark ``[marks]``; the time between a stop and going on is none.
        elapsed: of running up to now.
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
    """All arrays of a position by name; keys as their words."""
    return {name: on_host(leaf) for name, leaf in _named(_tree(position))}


def from_arrays(update: int, arrays: dict[str, np.ndarray], skeleton: Position) -> Position:
    """Arrays from a file, in the shape of a run.

    Args:
        update: steps taken.
        arrays: from `to_arrays`; files of old have no ``seconds``, and count the time of stops as running.
        skeleton: the shapes that the run needs, its reports and metrics without the axis of marks.

    Raises:
        ValueError: arrays that the run has not, or of other shapes or types.
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
    named = _named(tree)
    if sorted(name for name, _ in named) != sorted(arrays):
        raise ValueError("other arrays than the learners have")
    leaves = [_restored(name, arrays[name], leaf) for name, leaf in named]
    return Position(update=update, **jax.tree.unflatten(jax.tree.structure(tree), leaves))


def on_host(leaf: Any) -> np.ndarray:
    """A leaf as a NumPy array; of a key its words."""
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _tree(position: Position) -> dict[str, Any]:
    entries = position._asdict()
    del entries["update"]
    return entries


def _named(tree: Any) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]


def _is_key(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jax.dtypes.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _restored(name: str, array: np.ndarray, leaf: Any) -> Any:
    if _is_key(leaf):
        restored = unrolled(jax.random.wrap_key_data(jnp.asarray(array)))
        if restored.shape != leaf.shape or restored.dtype != leaf.dtype:
            raise ValueError(f"{name} holds keys of another shape or generator")
        return restored
    if array.shape != leaf.shape or array.dtype != leaf.dtype:
        raise ValueError(f"{name} is {array.dtype}{list(array.shape)}, not {leaf.dtype}{list(leaf.shape)}")
    return array
