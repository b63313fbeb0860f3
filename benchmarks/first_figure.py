"""How long a user waits for Figure 1: `make demo` in a fresh clone, again, its quick form, and what parts cost.

``python -m benchmarks.first_figure`` writes ``benchmarks/results/first_figure.json``.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row, number
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import potential_based
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.priors.potentials import mean_potential, stack
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast, run
from upslope.tasks import cartpoles

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        clone: also `make demo` in a fresh clone, twice: eight minutes more, and it needs pip to find packages.
    """

    clone: bool = False


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    set_up_devices(harness.scratch())
    config = MetaTrainingConfig(iterations=20) if options.quick else MetaTrainingConfig()
    updates = 100 if options.quick else 1000
    parts = {
        f"Algorithm 1, 1 seed ({config.iterations} iterations × 10 tasks)": Part(algorithm1(config, 1)),
        "Algorithm 1, 5 seeds": Part(algorithm1(config, 5)),
        f"DQN, 200 learners × {updates:,} updates, shaped by a mean of 5 priors": Part(dqn_learners(updates)),
    }
    rows = harness.time_in_turns(parts, 1 if options.quick else options.repeats)
    if not options.quick:
        rows |= quick_figure()
    if options.clone:
        rows |= fresh_clone()
    harness.write("first_figure", options, rows, bars=bars(rows))


def algorithm1(config: MetaTrainingConfig, seeds: int) -> Callable[[], object]:
    """Algorithm 1 with the default settings, snapshots and their trials included."""
    learners = broadcast(MetaTraining(cartpoles(), config), (seeds,))
    keys = jax.random.split(jax.random.key(0), seeds)
    return lambda: run(learners, keys, updates=config.iterations, every=config.snapshot_every)


def dqn_learners(updates: int) -> Callable[[], object]:
    """200 shaped DQN learners with the figure's settings, evaluated every 100 updates."""
    family, count = cartpoles(), 200
    tasks = family.sample_many(jax.random.key(1), count)
    network = MetaTraining(family).init(jax.random.key(2)).theta
    shaping = broadcast(potential_based(mean_potential(stack([network] * 5))), (count,))
    learners = DQN(family, tasks, shaping, DQNConfig(decay_updates=updates))
    keys = jax.random.split(jax.random.key(3), count)
    return lambda: run(learners, keys, updates=updates, every=100)


def quick_figure() -> dict[str, Row]:
    """The quick form as a user types it, each time in its own process; the first fills the cache for the second."""
    rows = {}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        for state in ("empty", "filled"):
            out = folder / state
            command = [sys.executable, "-m", "upslope.cli.main", "reproduce", "fig1", "--quick", "--out", str(out)]
            rows[f"{QUICK} ({state} cache)"] = watched(command, out, folder / "cache", ROOT)
    return rows


def fresh_clone() -> dict[str, Row]:
    """Clone, install, `make demo`, which draws the whole figure; then `make demo` again."""
    rows: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as text:
        clone = Path(text) / "clone"
        make = ["make", f"PYTHON={sys.executable}"]
        for name, command, cwd in (
            (CLONE, ["git", "clone", "-q", str(ROOT), str(clone)], ROOT),
            (INSTALL, [*make, ".venv/.installed"], clone),
        ):
            done = partial(subprocess.run, command, check=True, capture_output=True, cwd=cwd, env=bare())
            rows[name] = harness.spread([harness.seconds_of(done)])
        rows[INSTALL]["MiB installed"] = mebibytes(clone / ".venv")
        for name in (FIRST, SECOND):
            rows[name] = watched([*make, "demo"], clone / "runs", Path(text) / "cache", clone)
    return rows


def watched(command: list[str], out: Path, cache: Path, cwd: Path) -> Row:
    """A figure drawn by a process: when its picture is first there, when all is done, and what of it is computing."""
    environment = (dict(os.environ) if cwd == ROOT else bare()) | {"UPSLOPE_CACHE": str(cache)}
    known, first = set(out.rglob("figure.png")), float("nan")
    began = time.perf_counter()
    process = subprocess.Popen(command, env=environment, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        if first != first and set(out.rglob("figure.png")) - known:
            first = time.perf_counter() - began
        time.sleep(0.1)
    seconds = time.perf_counter() - began
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} failed with {process.returncode}.")
    (picture,) = set(out.rglob("figure.png")) - known
    results: dict[str, Any] = json.loads((picture.parent / "results.json").read_text(encoding="utf-8"))
    compiling, running = results["seconds_compiling"], results["seconds_running"]
    row = harness.spread([seconds]) | {"first_call": seconds, "compiling": compiling}
    return row | {FIRST_PICTURE: first if first == first else seconds, COMPUTING: compiling + running}


def bare() -> dict[str, str]:
    """The environment without what leads Python to this checkout."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def mebibytes(folder: Path) -> float:
    """Of all files in a folder."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20


def bars(rows: dict[str, Row]) -> list[Bar]:
    """A picture within three minutes of nothing; a second run within a third of the first one's compute time."""
    waited = None
    if FIRST in rows:
        waited = rows[CLONE]["median"] + rows[INSTALL]["median"] + rows[FIRST][FIRST_PICTURE]
    found = [Bar("Clone, install and make demo to the first picture: at most 180 s", waited, 180, True, _FIRST)]
    for form, first, second in (
        ("make demo, the whole figure", FIRST, SECOND),
        ("quick form", f"{QUICK} (empty cache)", f"{QUICK} (filled cache)"),
    ):
        what = f"A second run, {form}: at most a third of the first's compute time"
        if second not in rows:
            found.append(Bar(what, None, 1 / 3, True))
            continue
        share = rows[second][COMPUTING] / rows[first][COMPUTING]
        found.append(Bar(what, share, 1 / 3, True, second_bound(rows[first], rows[second])))
    return found


def second_bound(first: Row, second: Row) -> str:
    """Why a cache of compiled programs can't spare two thirds, in the numbers of the two runs."""
    compiling, running = first["compiling"] / first[COMPUTING], first[COMPUTING] - first["compiling"]
    return (
        f"running: waiting for programs is {compiling:.0%} of the first run's compute time, and a cache can spare no "
        f"more than that; the other {number(running)} s repeat the same work. Of the second run's "
        f"{number(second[COMPUTING])} s {number(second['compiling'])} are tracing in Python and loading, which it does "
        "not spare"
    )


QUICK, FIRST, SECOND = "upslope reproduce fig1 --quick", "fresh clone: make demo", "fresh clone: make demo again"
CLONE, INSTALL = "fresh clone: git clone", "fresh clone: install, as make demo does"
FIRST_PICTURE, COMPUTING = "seconds to the first picture", "seconds of computing"
_FIRST = "running: the first panel's priors, oracles and adaptation; see the parts"


if __name__ == "__main__":
    main(tyro.cli(Options))
