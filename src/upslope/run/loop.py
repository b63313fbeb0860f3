"""The one loop. It runs all learners, and knows no algorithm."""

import math
import time
from bisect import bisect_left
from contextlib import suppress

import jax
import numpy as np

from upslope.errors import NotSavedError, UpslopeError
from upslope.learners.learner import AbstractLearner
from upslope.run.checkpoints import Stage, describe
from upslope.run.compiling import Ahead, compile_clock, shapes_of
from upslope.run.engines import ENGINES, lay_out
from upslope.run.outcome import Outcome
from upslope.run.progress import Progress
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
        until: stop at the first report at or after this step; the run can be continued later. From the checkpoint of a
            run that went further, only the reports up to there are returned. None takes all steps.
        title: the name that observers show; with checkpoints, different from those of the session's other runs.
        session: observers, and where checkpoints go.
        allow_divergence: continue with non-finite metrics, as sweeps over step sizes must.

    Raises:
        UpslopeError: ``updates`` or ``every`` is below one, or a metric is not a finite number.
        DamagedFileError, NotSavedError: checkpoints or logs can't be read or written.
        InterruptedRunError: a signal stopped the run, after its last checkpoint; only raised with checkpoints.
    """
    if updates < 1 or every < 1:
        raise UpslopeError(f"{updates} updates, reported every {every}, can't be run: give at least 1 of each.")
    session = session or Session()
    stage = None
    if session.checkpoints is not None:
        stage = session.checkpoints.stage(title, describe(learners, keys, updates, every))
    marks = [0, *range(every, updates, every), updates]
    marks = marks if until is None else marks[: bisect_left(marks, until) + 1]
    with compile_clock() as clock:
        progress = Progress(learners, keys, marks, updates, title, allow_divergence)
        if stage is not None:
            progress.restore(stage.load(progress.skeleton, allow_divergence=allow_divergence))
        for observer in session.observers:
            observer.begin(title, marks[-1], progress.count)
        try:
            if stage is None:
                _finish(progress, session, None, StopRequest())
            else:
                with stop_requests() as request, request.defer():
                    _finish(progress, session, stage, request)
        except NotSavedError as error:
            error.outcome = progress.outcome(clock)
            raise
        finally:
            progress.close()
            for observer in session.observers:
                observer.end()
    return progress.outcome(clock)


def expect(learners: AbstractLearner, keys: Keys, ahead: Ahead) -> None:
    """Compiles the programs of a `run` in the background, for learners that share them.

    Args:
        learners: as for `run`. Only shapes and settings matter, not numbers.
        keys: as for `run`.
        ahead: the background; the run's session must have the same.
    """
    engine = ENGINES[learners.engine]
    learners, keys = lay_out(engine, learners, keys)
    ahead.submit(shapes_of((learners, keys)), lambda: engine.compile(learners, keys))


def _finish(progress: Progress, session: Session, stage: Stage | None, request: StopRequest) -> None:
    """Takes the remaining steps, chunk by chunk."""
    for index in range(len(progress.times)):
        _notify(session, progress, index)
    if progress.finished:
        return
    if session.ahead is not None:
        session.ahead.wait(shapes_of((progress.learners, progress.keys)))
    progress.start()
    pace = _Pace(1.0 if stage else math.inf)
    while not progress.finished:
        began = time.perf_counter()
        steps = pace.steps(progress.steps_left)
        at_mark = progress.advance(steps, lambda: f" ({stage.last_good()}.)" if stage else "")
        pace.learn(steps, time.perf_counter() - began)
        try:
            if at_mark:
                _notify(session, progress, len(progress.times) - 1)
        except NotSavedError:
            if stage is not None:
                with suppress(NotSavedError):
                    stage.save(progress.position(), allow_divergence=progress.allow_divergence)
            raise
        if stage is not None and progress.times and (request.signal or stage.due(progress.update)):
            stage.save(progress.position(), allow_divergence=progress.allow_divergence)
        if request.signal:
            request.stop(f"{progress.title}: stopped at update {progress.update} of {progress.marks[-1]}")
    if stage is not None:
        keep = stage.finish if progress.update == progress.updates else stage.save
        keep(progress.position(), allow_divergence=progress.allow_divergence)


def _notify(session: Session, progress: Progress, index: int) -> None:
    update, report = progress.marks[index], progress.reports[index]
    for observer in session.observers:
        observer.record(update, report["return"], progress.metrics[index], at=progress.times[index])


class _Pace:
    """The length of chunks: about a second each, so that the loop often checks whether to save or to stop.

    Args:
        seconds: the time that a chunk should take; infinite for chunks of any length.
    """

    def __init__(self, seconds: float):
        self._seconds = seconds
        self._longest = 1 if math.isfinite(seconds) else None

    def steps(self, wanted: int) -> int:
        """The number of steps to take now, at most those wanted."""
        return wanted if self._longest is None else min(wanted, self._longest)

    def learn(self, steps: int, seconds: float) -> None:
        """Adjusts the length to the time that a chunk took; a chunk of no steps says nothing."""
        if self._longest is not None and steps:
            fitting = int(steps * self._seconds / max(seconds, 1e-9))
            self._longest = max(1, min(fitting, 8 * self._longest))


def broadcast(learner: AbstractLearner, batch: tuple[int, ...]) -> AbstractLearner:
    """Copies of one learner, as a batch ``[*batch, ...]``."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (*batch, *np.shape(leaf))), learner)
