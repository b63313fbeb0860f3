"""Observers of a run: a progress bar, TensorBoard event files, a JSON-lines file."""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from upslope.errors import NotSavedError


@runtime_checkable
class Observer(Protocol):
    """Is notified of the start of a run, of every report and of the end."""

    def begin(self, title: str, updates: int, learners: int) -> None: ...

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray], *, at: float) -> None:
        """After ``update`` steps: the raw return of each learner ``[learners]``, metrics likewise.

        A resumed run repeats all reports from before it stopped. Observers that write files write them from the
        beginning, so that they have neither gaps nor duplicates.

        Args:
            update: steps taken.
            returns: ``[learners]``.
            metrics: ``[learners, ...]``.
            at: when, in seconds of the Unix clock.
        """
        ...

    def end(self) -> None: ...


def has_display() -> bool:
    """Whether somebody can watch: standard error is a terminal, or this is a notebook."""
    console = Console(stderr=True)
    return console.is_terminal or console.is_jupyter


class ProgressBar:
    """A bar with the rate in learner-updates per second, the time left (at the end, taken) and the median return."""

    def __init__(self, console: Console | None = None):
        self._progress = Progress(
            TextColumn("{task.description:<23}"),
            BarColumn(bar_width=12),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]:>9}"),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            TextColumn("return {task.fields[median]:>5.1f}"),
            console=console or Console(stderr=True),
        )

    def begin(self, title: str, updates: int, learners: int) -> None:
        self._learners = learners
        self._began = time.time()
        self._first: tuple[int, float] | None = None
        self._progress.start()
        self._bar = self._progress.add_task(title, total=updates, median=0.0, rate="compiling")

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray], *, at: float) -> None:
        del metrics
        if self._first is None or at < self._began:
            self._first = (update, at)
        first_update, first_at = self._first
        rate = self._learners * (update - first_update) / max(at - first_at, 1e-9)
        self._progress.update(self._bar, completed=update, median=float(np.median(returns)), rate=f"{rate:,.0f}/s")

    def end(self) -> None:
        self._progress.stop()


class EventLog:
    """TensorBoard event files and ``metrics.jsonl``, in one folder for each run.

    Each record holds quartiles of the returns over the learners, and the mean of every metric.

    Raises:
        NotSavedError: a file that can't be written.
    """

    def __init__(self, folder: Path):
        self._folder = folder

    def begin(self, title: str, updates: int, learners: int) -> None:
        del updates
        self._title = title
        self._learners = learners
        folder = self._folder / title.replace(" ", "_")
        with _writing(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            self._lines = (folder / "metrics.jsonl").open("w", encoding="utf-8")
            from tensorboardX import SummaryWriter  # loads PyTorch where that is installed, which takes seconds

            self._events = SummaryWriter(str(folder))

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray], *, at: float) -> None:
        q1, median, q3 = np.percentile(returns, [25, 50, 75])
        scalars = {"return/median": median, "return/lower_quartile": q1, "return/upper_quartile": q3}
        scalars |= {f"metrics/{name}": np.mean(values) for name, values in metrics.items()}
        line = {"run": self._title, "learners": self._learners, "update": update, "at": at}
        line |= {name: float(value) for name, value in scalars.items()}
        with _writing(self._folder):
            self._lines.write(json.dumps(line) + "\n")
            self._lines.flush()
            for name, value in scalars.items():
                self._events.add_scalar(name, float(value), update, walltime=at)

    def end(self) -> None:
        with suppress(OSError):  # all records are on the disk already
            self._events.close()
            self._lines.close()


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotSavedError(
            f"The logs in {folder} can't be written ({error.strerror or error}): free some space, or give a folder "
            "that can be written to."
        ) from error
