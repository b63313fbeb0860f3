"""A run in progress: its learners' states on the devices, and what it has reported so far."""

import math
import time
import warnings
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from upslope.learners.learner import AbstractLearner
from upslope.run.compiling import CompileClock
from upslope.run.engines import ENGINES, lay_out, pad
from upslope.run.health import check_finite
from upslope.run.outcome import Outcome
from upslope.run.position import Position, to_numpy
from upslope.types import Keys


class Progress:
    """A run in progress: what `Position` holds, on the devices and as lists."""

    def __init__(
        self,
        learners: AbstractLearner,
        keys: Keys,
        marks: list[int],
        updates: int,
        title: str,
        allow_divergence: bool,
    ):
        self.batch, self.count = keys.shape, math.prod(keys.shape)
        self.engine = ENGINES[learners.engine]
        self.learners, self.keys = lay_out(self.engine, learners, keys)
        self.marks, self.updates, self.title, self.allow_divergence = marks, updates, title, allow_divergence
        self.states: Any = None
        self.totals: Any = None
        self.update = 0
        self.reports: list[Any] = []
        self.metrics: list[Any] = []
        self.times: list[float] = []
        self.seconds: list[float] = []
        self.began = time.perf_counter()

    def skeleton(self) -> Position:
        """The shapes of a `Position`, without the padding."""
        own = jax.tree.map(lambda leaf: leaf[: self.count] if np.ndim(leaf) else leaf, (self.learners, self.keys))
        states, totals, report = self.engine.shapes(*own)
        return Position(states, totals, 0, report, totals, np.zeros(0), np.zeros(0), np.zeros(()))

    def restore(self, position: Position | None) -> None:
        """Continues from a checkpoint."""
        if position is None:
            return
        if not self.engine.restores_episodes:
            warnings.warn(f"{self.title}: its episodes can't be restored, so new ones start.", stacklevel=3)
        known = len(self.marks)
        self.update = position.update
        self.times, self.seconds = position.times[:known].tolist(), position.seconds[:known].tolist()
        self.began -= float(position.elapsed)
        for index in range(len(self.times)):
            at_mark = jax.tree.map(lambda leaf, i=index: leaf[:, i], (position.reports, position.metrics))
            self.reports.append(at_mark[0])
            self.metrics.append(at_mark[1])
        if position.states is not None and self.update <= self.marks[-1]:
            whole = jax.tree.map(lambda leaf: pad(self.engine, leaf), (position.states, position.totals))
            self.states, self.totals = self.engine.spread(self.learners, whole)

    def start(self) -> None:
        """Starts the learners, unless a checkpoint gave their states."""
        if self.states is None:
            self.states, self.totals = self.engine.start(self.learners, self.keys)

    @property
    def steps_left(self) -> int:
        """The number of steps up to the next mark."""
        return self.marks[len(self.times)] - self.update

    @property
    def finished(self) -> bool:
        """Whether the last mark is reached."""
        return len(self.times) == len(self.marks)

    def advance(self, steps: int, last_good: Callable[[], str]) -> bool:
        """Takes a chunk of steps. Returns whether it ended at a mark."""
        mark = self.marks[len(self.times)]
        last = self.marks[len(self.times) - 1] if self.times else 0
        at_mark = self.update + steps == mark
        chunk = self.engine.advance(
            self.learners, self.states, self.totals, steps, fresh=self.update == last, report=at_mark
        )
        self.states, self.totals = chunk.states, chunk.totals
        if not self.allow_divergence:
            check_finite(self.title, self.update, np.asarray(chunk.broken)[: self.count], self.totals, last_good)
        self.update += steps
        if at_mark:
            totals, report = jax.tree.map(lambda leaf: np.asarray(leaf)[: self.count], (self.totals, chunk.report))
            self.metrics.append(jax.tree.map(lambda leaf: leaf / leaf.dtype.type(max(mark - last, 1)), totals))
            self.reports.append(report)
            self.times.append(time.time())
            self.seconds.append(time.perf_counter() - self.began)
        return at_mark

    def position(self) -> Position:
        """The whole run so far, on the host."""
        states, totals = jax.tree.map(lambda leaf: to_numpy(leaf)[: self.count], (self.states, self.totals))
        return Position(
            states,
            totals,
            self.update,
            _along_marks(self.reports),
            _along_marks(self.metrics),
            np.asarray(self.times),
            np.asarray(self.seconds),
            np.asarray(time.perf_counter() - self.began),
        )

    def outcome(self, clock: CompileClock) -> Outcome:
        """The results so far."""
        by_mark = _along_marks(self.reports), _along_marks(self.metrics)
        reports, metrics = jax.tree.map(lambda leaf: leaf.reshape(*self.batch, *leaf.shape[1:]), by_mark)
        updates = np.asarray(self.marks[: len(self.times)])
        seconds = np.asarray(self.seconds)
        times = clock.seconds, clock.seconds_running
        return Outcome(self.states, self.batch, updates, seconds, reports, metrics, *times, clock.programs)

    def close(self) -> None:
        """Releases what the learners hold open."""
        self.engine.close(self.learners)


def _along_marks(items: list[Any]) -> Any:
    """Stacks ``[learners, ...]`` of every mark to ``[learners, marks, ...]``."""
    return jax.tree.map(lambda *leaves: np.stack(leaves, 1), *items) if items else {}
