"""The result of a run."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np


class Outcome(NamedTuple):
    """The result of a run.

    Attributes:
        flat_states: final states of all learners, with one batch axis; None if a finished run was resumed whose states
            were not kept.
        batch: the batch axes.
        updates: steps taken at each report ``[reports]``.
        seconds: running time up to each report ``[reports]``, with compiling, without the time that a run was stopped.
        reports: the learners' reports, by name ``[*batch, reports, ...]``.
        metrics: means of the learners' metrics between reports, by name ``[*batch, reports, ...]``; zeros before the
            first step.
        seconds_compiling: time spent on tracing and compiling.
        seconds_running: all other time.
        programs: the number of programs compiled.
    """

    flat_states: Any
    batch: tuple[int, ...]
    updates: np.ndarray
    seconds: np.ndarray
    reports: dict[str, Any]
    metrics: dict[str, np.ndarray]
    seconds_compiling: float
    seconds_running: float
    programs: int

    @property
    def states(self) -> Any:
        """Final states of all learners ``[*batch, ...]``, gathered from the devices at each access."""
        count = math.prod(self.batch)
        return jax.tree.map(lambda leaf: leaf[:count].reshape(*self.batch, *leaf.shape[1:]), self.flat_states)
