"""What people see of a run: a progress bar, TensorBoard event files, a JSON-lines file."""

import json
import time
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from tensorboardX import SummaryWriter


@runtime_checkable
class Observer(Protocol):
    """Is told of the start of a run, of every report and of the end."""

    def begin(self, title: str, updates: int, learners: int) -> None: ...

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray]) -> None:
        """After ``update`` steps: the raw return of each learner ``[learners]``, metrics likewise."""
        ...

    def end(self) -> None: ...


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
        self._progress.start()
        self._bar = self._progress.add_task(title, total=updates, median=0.0, rate="compiling")

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray]) -> None:
        del metrics
        if update == 0:
            self._started = time.perf_counter()
        rate = self._learners * update / max(time.perf_counter() - self._started, 1e-9)
        self._progress.update(self._bar, completed=update, median=float(np.median(returns)), rate=f"{rate:,.0f}/s")

    def end(self) -> None:
        self._progress.stop()


class EventLog:
    """TensorBoard event files and ``metrics.jsonl``, under one folder.

    Each record holds quartiles of the returns over the learners, and the mean of every metric.
    """

    def __init__(self, folder: Path):
        self._folder = folder

    def begin(self, title: str, updates: int, learners: int) -> None:
        del updates
        self._title = title
        self._learners = learners
        self._folder.mkdir(parents=True, exist_ok=True)
        self._events = SummaryWriter(str(self._folder / "events" / title.replace(" ", "_")))
        self._lines = (self._folder / "metrics.jsonl").open("a", encoding="utf-8")

    def record(self, update: int, returns: np.ndarray, metrics: dict[str, np.ndarray]) -> None:
        q1, median, q3 = np.percentile(returns, [25, 50, 75])
        scalars = {"return/median": median, "return/lower_quartile": q1, "return/upper_quartile": q3}
        scalars |= {f"metrics/{name}": np.mean(values) for name, values in metrics.items()}
        for name, value in scalars.items():
            self._events.add_scalar(name, float(value), update)
        line = {"run": self._title, "learners": self._learners, "update": update}
        line |= {name: float(value) for name, value in scalars.items()}
        self._lines.write(json.dumps(line) + "\n")
        self._lines.flush()

    def end(self) -> None:
        self._events.close()
        self._lines.close()
