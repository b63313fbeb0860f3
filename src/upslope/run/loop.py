"""The one loop. It runs whatever learns, and knows nothing of any algorithm."""

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from upslope.errors import UpslopeError
from upslope.learner import AbstractLearner
from upslope.run import chunks
from upslope.run.compiling import compile_clock
from upslope.run.observers import Observer
from upslope.run.randomness import unrolled
from upslope.types import Keys


class Outcome(NamedTuple):
    """What a run leaves behind.

    Attributes:
        flat_states: of all learners at the end, their batch axes flattened and padded for the devices.
        batch: the batch axes.
        updates: steps taken at each report ``[reports]``.
        reports: what the learners reported, by name ``[*batch, reports, ...]``.
        metrics: chunk means of the learners' metrics, by name ``[*batch, reports]``; zeros before the first step.
        seconds_compiling: spent on tracing and compiling.
        seconds_running: all the rest.
        programs: how many were compiled.
    """

    flat_states: Any
    batch: tuple[int, ...]
    updates: np.ndarray
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


def run(
    learners: AbstractLearner,
    keys: Keys,
    *,
    updates: int,
    every: int,
    title: str = "learning",
    observers: Sequence[Observer] = (),
    allow_divergence: bool = False,
) -> Outcome:
    """Runs a batch of learners side by side, reporting before the first step and after every ``every`` steps.

    Args:
        learners: one learner whose array leaves carry the batch axes ``[*batch, ...]``; 0-d leaves are shared by all.
        keys: one key for each learner ``[*batch]``.
        updates: steps of each learner.
        every: steps between reports.
        title: what observers call this run.
        observers: told of the start, of every report and of the end.
        allow_divergence: carry on with non-finite metrics, as sweeps over step sizes must.

    Raises:
        UpslopeError: ``updates`` or ``every`` below one, or a metric that is not a finite number.
    """
    if updates < 1 or every < 1:
        raise UpslopeError(f"{updates} updates, reported every {every}, can't be run: give at least 1 of each.")
    began = time.perf_counter()
    batch = keys.shape
    count = math.prod(batch)
    learners = jax.tree.map(lambda leaf: _flatten(leaf, batch, count) if np.ndim(leaf) else leaf, learners)
    learners, keys = chunks.spread((learners, _flatten(unrolled(keys), batch, count)))
    marks = [0, *range(every, updates, every), updates]
    reports, metrics = [], []
    with compile_clock() as clock:
        for observer in observers:
            observer.begin(title, updates, count)
        try:
            states = chunks.start(learners, keys)
            for before, mark in zip([0, *marks], marks, strict=False):
                states, chunk_metrics, report = chunks.advance(learners, states, mark - before)
                chunk_metrics, report = jax.tree.map(lambda leaf: np.asarray(leaf)[:count], (chunk_metrics, report))
                if not allow_divergence:
                    _check_finite(title, mark, chunk_metrics)
                metrics.append(chunk_metrics)
                reports.append(report)
                for observer in observers:
                    observer.record(mark, report["return"], chunk_metrics)
        finally:
            for observer in observers:
                observer.end()

    def stacked(items: list) -> Any:
        return jax.tree.map(
            lambda *leaves: np.stack(leaves, 1).reshape(*batch, len(marks), *leaves[0].shape[1:]), *items
        )

    return Outcome(
        states,
        batch,
        np.asarray(marks),
        stacked(reports),
        stacked(metrics),
        clock.seconds,
        time.perf_counter() - began - clock.seconds,
        clock.programs,
    )


def broadcast(learner: AbstractLearner, batch: tuple[int, ...]) -> AbstractLearner:
    """One learner as a batch of equal ones ``[*batch, ...]``."""
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (*batch, *np.shape(leaf))), learner)


def _flatten(leaf: Any, batch: tuple[int, ...], count: int) -> Any:
    """The batch axes as one, padded by repetition of the last learner until the devices divide it."""
    leaf = leaf.reshape(count, *leaf.shape[len(batch) :])
    missing = -count % len(jax.local_devices())
    return jnp.concatenate([leaf, *[leaf[-1:]] * missing]) if missing else leaf


def _check_finite(title: str, update: int, metrics: dict[str, np.ndarray]) -> None:
    for name, values in metrics.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise UpslopeError(
                f"{title}: {name} of learner {bad[0]} is not a finite number by update {update} "
                f"({bad.size} of {values.size} learners): lower the step size, or check the potential and the rewards."
            )
