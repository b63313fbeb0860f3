"""What checkpoints cost: one save by the size of the state, and their share of a run at the default cadence.

``python -m benchmarks.checkpoints`` writes ``benchmarks/results/checkpoints.json``.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks import harness
from upslope.learners.dqn import DQN, DQNConfig
from upslope.run.checkpoints import Checkpoints, Stage
from upslope.run.compiling import set_up_devices
from upslope.run.loop import run
from upslope.run.session import Session
from upslope.tasks import cartpoles


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        updates: of the long run of 200 DQN learners; some minutes, so that saves at the default cadence fall into it.
    """

    updates: int = 60_000


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
    """Trains ``count`` DQNs; returns the seconds that it took, without compiling."""
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
            rows[f"one save, {count} learners"] = harness.spread(watched.seconds[1 : options.repeats + 1]) | {
                "MiB": watched.bytes / 2**20
            }
        watched.seconds.clear()
        total = learn(200, 1000 if options.quick else options.updates, 1000, Checkpoints(root / "long"))
    saving = sum(watched.seconds)
    rows["a long run of 200 learners"] = harness.spread([total]) | {
        "saves": len(watched.seconds),
        "seconds saving": saving,
        "% of the run": 100 * saving / total,
    }
    harness.write("checkpoints", options, rows)


if __name__ == "__main__":
    main(tyro.cli(Options))
