"""What checkpoints cost: one save by the size of the state, and their share of a run at the default cadence.

``python -m benchmarks.checkpoints`` writes ``benchmarks/results/checkpoints.json``.
"""

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from upslope.agents.dqn import DQN, DQNConfig
from upslope.run.checkpoints import Checkpoints, Stage
from upslope.run.compiling import set_up_devices
from upslope.run.loop import run
from upslope.run.machine import hardware, versions
from upslope.run.session import Session
from upslope.tasks import cartpoles

RESULTS = Path(__file__).parent / "results" / "checkpoints.json"


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 5
    """Saves of each size."""
    updates: int = 60_000
    """Of the long run of 200 DQN learners; some minutes, so that saves at the default cadence fall into it."""


class Watched:
    """Counts what `Stage.save` takes."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.bytes = 0
        inner = Stage.save

        def save(stage: Stage, *args: Any, **kwargs: Any) -> Path:
            began = time.perf_counter()
            path = inner(stage, *args, **kwargs)
            self.seconds.append(time.perf_counter() - began)
            self.bytes = path.stat().st_size
            return path

        Stage.save = save  # type: ignore[method-assign]


def learn(count: int, updates: int, every: int, checkpoints: Checkpoints) -> float:
    """Trains ``count`` DQNs; returns the seconds that it took, compiling apart."""
    family = cartpoles()
    tasks = family.sample_many(jax.random.key(1), count)
    learners = DQN(family, tasks, None, DQNConfig(decay_updates=0))
    keys = jax.random.split(jax.random.key(3), count)
    return run(learners, keys, updates=updates, every=every, session=Session((), checkpoints)).seconds_running


def main(options: Options) -> None:
    """Saves of three sizes, then one long run."""
    set_up_devices()
    watched = Watched()
    rows = {}
    with tempfile.TemporaryDirectory() as text:
        root = Path(text)
        for count in (1, 20, 200):
            watched.seconds.clear()
            # One more save, the first, finds nothing in the page cache; it is not counted.
            learn(count, options.repeats + 1, 1, Checkpoints(root / str(count), every_updates=1))
            times = watched.seconds[1 : options.repeats + 1]
            rows[f"one save, {count} learners"] = {
                "megabytes": watched.bytes / 2**20,
                "median": float(np.median(times)),
                "fastest": min(times),
                "slowest": max(times),
            }
        watched.seconds.clear()
        total = learn(200, options.updates, 1000, Checkpoints(root / "long"))
    share = sum(watched.seconds) / total
    long = {"seconds": total, "saves": len(watched.seconds), "seconds_saving": sum(watched.seconds), "share": share}
    RESULTS.parent.mkdir(exist_ok=True)
    content = {"rows": rows, "long_run": long, "versions": versions(), "hardware": hardware()}
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    table = Table("", "MiB", "seconds", "range", title="Checkpoints")
    for name, row in rows.items():
        span = f"{row['fastest']:.3f} to {row['slowest']:.3f}"
        table.add_row(name, f"{row['megabytes']:.1f}", f"{row['median']:.3f}", span)
    Console().print(table)
    print(f"{long['saves']} saves took {100 * share:.2f} % of a run of {total:.0f} seconds. Written to {RESULTS}.")


if __name__ == "__main__":
    main(tyro.cli(Options))
