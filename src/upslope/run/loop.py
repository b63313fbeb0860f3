"""The one loop. It runs whatever learns, and knows nothing of any algorithm."""

import math
import time
import warnings
from bisect import bisect_left
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import jax
import numpy as np

from upslope.errors import NotSavedError, UpslopeError
from upslope.learners.learner import AbstractLearner
from upslope.run.ahead import Ahead, shapes_of
from upslope.run.checkpoints import Stage, describe
from upslope.run.compiling import CompileClock, compile_clock
from upslope.run.engines import host as host_chunks
from upslope.run.health import check_finite
from upslope.run.layout import laid_out, padded
from upslope.run.outcome import Outcome
from upslope.run.pace import Pace
from upslope.run.position import Position, on_host
from upslope.run.session import Session
from upslope.run.signals import StopRequest, stop_requests
from upslope.types import Keys


def run(
    learners: AbstractLearner,
    keys: Keys,
    *,
    updates: int,
    every: int,
    until: int | None = None,
    title: str = "learning",
    session: Session | None = None,
    allow_divergence: bool = False,
) -> Outcome:
    """Runs a batch of learners side by side, reporting before the first step and after every ``every`` steps.

    Args:
        learners: one learner whose array leaves carry the batch axes ``[*batch, ...]``; 0-d leaves are shared by all.
        keys: one key for each learner ``[*batch]``.
        updates: steps of each learner.
        every: steps between reports.
        until: end at the first report at or after this step, as a run stopped there that can be gone on with; of one
            that had gone farther, leave out what came later. None takes all steps.
        title: what observers call this run; with checkpoints, different from those of the session's other runs.
        session: who watches, and where checkpoints go.
        allow_divergence: carry on with non-finite metrics, as sweeps over step sizes must.

    Raises:
        UpslopeError: ``updates`` or ``every`` below one, or a metric that is not a finite number.
        DamagedFileError, NotSavedError: trouble with checkpoints or logs.
        InterruptedRunError: a signal; only where there are checkpoints, and after the last of them.
    """
    if updates < 1 or every < 1:
        raise UpslopeError(f"{updates} updates, reported every {every}, can't be run: give at least 1 of each.")
    session = session or Session()
    stage = None
    if session.checkpoints is not None:
        stage = session.checkpoints.stage(title, describe(learners, keys, updates, every))
    batch, count = keys.shape, math.prod(keys.shape)
    marks = [0, *range(every, updates, every), updates]
    marks = marks if until is None else marks[: bisect_left(marks, until) + 1]
    with compile_clock() as clock:
        engine, learners, keys = laid_out(learners, keys)
        going = _Run(engine, learners, keys, count, marks, updates, title, allow_divergence)
        if stage is not None:
            going.restore(stage.load(going.skeleton, allow_divergence=allow_divergence))
        for observer in session.observers:
            observer.begin(title, marks[-1], count)
        try:
            if stage is None:
                going.finish(session, None, StopRequest())
            else:
                with stop_requests() as request, request.deferred():
                    going.finish(session, stage, request)
        except NotSavedError as error:
            error.outcome = going.outcome(batch, clock)
            raise
        finally:
            engine.close(learners)
            for observer in session.observers:
                observer.end()
    return going.outcome(batch, clock)


def expect(learners: AbstractLearner, keys: Keys, ahead: Ahead) -> None:
    """Has the programs of a `run` compiled in the background, for learners that share it.

    Args:
        learners: as `run` takes them, of a compiled family; only shapes and settings count, not the numbers in them.
        keys: likewise.
        ahead: the background; the run's session must have the same.
    """
    engine, learners, keys = laid_out(learners, keys)
    ahead.submit(shapes_of((learners, keys)), lambda: engine.compile(learners, keys))


class _Run:
    """A run in progress: what `Position` holds, on the devices and as lists."""

    def __init__(
        self,
        engine: Any,
        learners: AbstractLearner,
        keys: Keys,
        count: int,
        marks: list[int],
        updates: int,
        title: str,
        allow_divergence: bool,
    ):
        self.engine = engine
        self.learners, self.keys, self.count, self.marks = learners, keys, count, marks
        self.updates, self.title, self.allow_divergence = updates, title, allow_divergence
        self.states: Any = None
        self.totals: Any = None
        self.update = 0
        self.reports: list[Any] = []
        self.metrics: list[Any] = []
        self.times: list[float] = []
        self.seconds: list[float] = []
        self.began = time.perf_counter()

    def skeleton(self) -> Position:
        """The shapes of a `Position`, of the learners without the padding."""
        own = jax.tree.map(lambda leaf: leaf[: self.count] if np.ndim(leaf) else leaf, (self.learners, self.keys))
        states, totals, report = self.engine.shapes(*own)
        return Position(states, totals, 0, report, totals, np.zeros(0), np.zeros(0), np.zeros(()))

    def restore(self, position: Position | None) -> None:
        """Goes on from a checkpoint."""
        if position is None:
            return
        if self.engine is host_chunks:
            warnings.warn(f"{self.title}: episodes on the host can't be restored; new ones are begun.", stacklevel=3)
        known = len(self.marks)
        self.update = position.update
        self.times, self.seconds = position.times[:known].tolist(), position.seconds[:known].tolist()
        self.began -= float(position.elapsed)
        for index in range(len(self.times)):
            at_mark = jax.tree.map(lambda leaf, i=index: leaf[:, i], (position.reports, position.metrics))
            self.reports.append(at_mark[0])
            self.metrics.append(at_mark[1])
        if position.states is not None and self.update <= self.marks[-1]:
            whole = jax.tree.map(lambda leaf: padded(leaf, self.engine), (position.states, position.totals))
            self.states, self.totals = self.engine.spread(self.learners, whole)

    def finish(self, session: Session, stage: Stage | None, request: StopRequest) -> None:
        """Takes the steps that are missing."""
        for index in range(len(self.times)):
            self._tell(session, index)
        if len(self.times) == len(self.marks):
            return
        if session.ahead is not None:
            session.ahead.wait(shapes_of((self.learners, self.keys)))
        if self.states is None:
            self.states, self.totals = self.engine.start(self.learners, self.keys)
        pace = Pace(1.0 if stage else math.inf)
        while len(self.times) < len(self.marks):
            began = time.perf_counter()
            steps = pace.steps(self.marks[len(self.times)] - self.update)
            at_mark = self._advance(steps, lambda: f" ({stage.last_good()}.)" if stage else "")
            pace.took(steps, time.perf_counter() - began)
            try:
                if at_mark:
                    self._tell(session, len(self.times) - 1)
            except NotSavedError:
                if stage is not None:
                    with suppress(NotSavedError):
                        stage.save(self.position(), allow_divergence=self.allow_divergence)
                raise
            if stage is not None and self.times and (request.signal or stage.due(self.update)):
                stage.save(self.position(), allow_divergence=self.allow_divergence)
            if request.signal:
                request.stop(f"{self.title}: stopped at update {self.update} of {self.marks[-1]}")
        if stage is not None:
            keep = stage.finish if self.update == self.updates else stage.save
            keep(self.position(), allow_divergence=self.allow_divergence)

    def _advance(self, steps: int, known_good: Callable[[], str]) -> bool:
        """One chunk. Returns whether it ended at a mark."""
        mark = self.marks[len(self.times)]
        last = self.marks[len(self.times) - 1] if self.times else 0
        at_mark = self.update + steps == mark
        chunk = self.engine.advance(
            self.learners, self.states, self.totals, steps, fresh=self.update == last, report=at_mark
        )
        self.states, self.totals = chunk.states, chunk.totals
        if not self.allow_divergence:
            check_finite(self.title, self.update, np.asarray(chunk.broken)[: self.count], self.totals, known_good)
        self.update += steps
        if at_mark:
            totals, report = jax.tree.map(lambda leaf: np.asarray(leaf)[: self.count], (self.totals, chunk.report))
            self.metrics.append(jax.tree.map(lambda leaf: leaf / leaf.dtype.type(max(mark - last, 1)), totals))
            self.reports.append(report)
            self.times.append(time.time())
            self.seconds.append(time.perf_counter() - self.began)
        return at_mark

    def _tell(self, session: Session, index: int) -> None:
        for observer in session.observers:
            observer.record(self.marks[index], self.reports[index]["return"], self.metrics[index], at=self.times[index])

    def position(self) -> Position:
        """All of it, on the host."""
        states, totals = jax.tree.map(lambda leaf: on_host(leaf)[: self.count], (self.states, self.totals))
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

    def outcome(self, batch: tuple[int, ...], clock: CompileClock) -> Outcome:
        """What there is by now."""
        reports, metrics = jax.tree.map(
            lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), (_along_marks(self.reports), _along_marks(self.metrics))
        )
        updates = np.asarray(self.marks[: len(self.times)])
        seconds = np.asarray(self.seconds)
        return Outcome(
            self.states, batch, updates, seconds, reports, metrics, clock.seconds, clock.seconds_running, clock.programs
        )


def broadcast(learner: AbstractLearner, batch: tuple[int, ...]) -> AbstractLearner:
    """One learner as a batch of equal ones ``[*batch, ...]``."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (*batch, *np.shape(leaf))), learner)


def _along_marks(items: list[Any]) -> Any:
    """``[learners, ...]`` of every mark as ``[learners, marks, ...]``."""
    return jax.tree.map(lambda *leaves: np.stack(leaves, 1), *items) if items else {}
