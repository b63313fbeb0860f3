"""Numbers that are not finite, found at the step where they start, with the likely cause and the fix."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from upslope.errors import UpslopeError
from upslope.types import Metrics

#: Words in a metric's name, in the order in which trouble spreads, and the fix.
_FIXES = (
    ("observation", "check what the environment shows there, and the task's parameters."),
    ("reward", "check the rewards of the environment and the potential."),
    ("loss", "lower the step size, or check the size of the rewards and of the potential."),
    ("gradient", "lower the step size."),
    ("", "lower the step size, or check the rewards and the potential."),
)


def all_finite(metrics: Metrics) -> Bool[Array, ""]:
    """Whether all metrics of a step are finite; part of the compiled programs."""
    return jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(metrics)]).all()


def check_finite(
    title: str, update: int, broken: np.ndarray, totals: dict[str, Any], last_good: Callable[[], str]
) -> None:
    """Checks the metrics of a chunk of steps.

    Args:
        title: of the run.
        update: steps taken before the chunk.
        broken: for each learner the first step of the chunk with a metric that is not finite; 0 if there is none.
        totals: sums of the metrics ``[learners, ...]``; a second axis is that of tasks.
        last_good: names the checkpoint to go back to; only called if a metric is not finite.

    Raises:
        UpslopeError: a metric is not finite. Names the run, the learner, the task and the step.
    """
    if not broken.any():
        return
    learner = int(np.flatnonzero(broken)[0])
    bad = {name: ~np.isfinite(np.asarray(values)[learner]) for name, values in totals.items()}
    name = min((name for name, places in bad.items() if places.any()), key=_phase)
    task = f", task {int(np.flatnonzero(bad[name])[0])}" if bad[name].ndim else ""
    raise UpslopeError(
        f"{title}: {name} of learner {learner}{task} is not a finite number at update {update + broken[learner]} "
        f"({np.count_nonzero(broken)} of {broken.size} learners are affected): {_FIXES[_phase(name)][1]}{last_good()}"
    )


def first_not_finite(arrays: dict[str, np.ndarray]) -> str | None:
    """The name of the first array that holds numbers that are not finite; None if all are."""
    floats = ((name, array) for name, array in arrays.items() if np.issubdtype(array.dtype, np.floating))
    return next((name for name, array in floats if not np.isfinite(array).all()), None)


def _phase(name: str) -> int:
    return next(index for index, (word, _) in enumerate(_FIXES) if word in name)
