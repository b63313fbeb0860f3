"""What a run leaves behind."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np


class Outcome(NamedTuple):
    """What a run leaves behind.

    Attributes:
        flat_states: of all learners at the end, their batch axes flattened; None where a finished run was resumed whose
            states were not kept.
        batch: the batch axes.
        updates: steps taken at each report ``[reports]``.
        seconds: of running up to each report ``[reports]``, compiling included; while a run is stopped none pass.
        reports: what the learners reported, by name ``[*batch, reports, ...]``.
        metrics: means of the learners' metrics between reports, by name ``[*batch, reports, ...]``; zeros before the
            first step.
        seconds_compiling: spent on tracing and compiling.
        seconds_running: all the rest.
        programs: how many were compiled.
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
        """Of all learners at the end ``[*batch, ...]``; gathered from the devices when asked for."""
        count = math.prod(self.batch)
        return jax.tree.map(lambda leaf: leaf[:count].reshape(*self.batch, *leaf.shape[1:]), self.flat_states)
