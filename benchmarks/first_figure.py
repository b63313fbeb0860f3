"""How long a user waits for Figure 1: from a fresh clone, for a first run, for a second one; and what its parts cost.

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
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row
from upslope.agents.dqn import DQN, DQNConfig
from upslope.meta_training import MetaTraining
from upslope.potentials import mean_potential, stack
from upslope.recipes import MetaTrainingConfig
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast, run
from upslope.shaping import potential_based
from upslope.tasks import cartpoles

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        whole: also the whole figure from an empty and from a filled cache: ten minutes more.
        clone: also the quick figure from a fresh clone, installation included, and a second time; it needs a network.
    """

    whole: bool = False
    clone: bool = False


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    set_up_devices(harness.scratch())
    config = MetaTrainingConfig(iterations=20) if options.quick else MetaTrainingConfig()
    updates = 100 if options.quick else 3000
    parts = {
        f"Algorithm 1, 1 seed ({config.iterations} iterations × 10 tasks)": Part(algorithm1(config, 1)),
        "Algorithm 1, 5 seeds": Part(algorithm1(config, 5)),
        f"DQN, 200 learners × {updates} updates, shaped by a mean of 5 priors": Part(dqn_learners(updates)),
    }
    rows = harness.time_in_turns(parts, 1 if options.quick else options.repeats)
    measured: dict[str, float] = {}
    if not options.quick:
        rows |= figures(["--quick"], measured)
    if options.whole:
        rows |= figures([], measured)
    if options.clone:
        rows |= fresh_clone(measured)
    harness.write("first_figure", options, rows, bars=bars(measured))


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


def figures(arguments: list[str], measured: dict[str, float]) -> dict[str, Row]:
    """The command as a user types it, as processes of their own; the cache that the first fills warms the second."""
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for state in ("empty", "filled"):
            out = Path(folder) / state
            command = [sys.executable, "-m", "upslope.cli", "reproduce", "fig1", *arguments, "--out", str(out)]
            seconds, first = watched(command, out, Path(folder) / "cache", ROOT)
            name = " ".join(["upslope reproduce fig1", *arguments, f"({state} cache)"])
            rows[name] = row_of(seconds, first, out)
            measured[f"{'quick' if arguments else 'whole'}, {state}"] = rows[name]["seconds of computing"]
    return rows


def fresh_clone(measured: dict[str, float]) -> dict[str, Row]:
    """Clone, install, the quick figure; then the same command again."""
    rows: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        clone, python = folder / "clone", folder / "clone" / ".venv" / "bin" / "python"
        steps = {
            "git clone": ["git", "clone", "-q", ROOT, clone],
            "install, as make demo does": ["make", f"PYTHON={sys.executable}", ".venv/.installed"],
        }
        for name, command in steps.items():
            began = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True, cwd=clone if clone.exists() else ROOT)
            rows[f"fresh clone: {name}"] = harness.spread([time.perf_counter() - began])
        installed = sum(row["median"] for row in rows.values())
        for state in ("first", "second"):
            out = folder / state
            command = [str(python), "-m", "upslope.cli", "reproduce", "fig1", "--quick", "--out", str(out)]
            seconds, first = watched(command, out, folder / "cache", clone)
            rows[f"fresh clone: {state} run"] = row_of(seconds, first, out)
        measured["clone to picture"] = installed + rows["fresh clone: first run"]["seconds to a picture"]
    return rows


def watched(command: list[str], out: Path, cache: Path, cwd: Path) -> tuple[float, float]:
    """Seconds that a process took, and after which its folder held a picture."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH" or cwd == ROOT}
    environment |= {"UPSLOPE_CACHE": str(cache)}
    began, first = time.perf_counter(), float("nan")
    with open(os.devnull, "wb") as nowhere:
        process = subprocess.Popen(command, env=environment, cwd=cwd, stdout=nowhere, stderr=nowhere)
        while process.poll() is None:
            if first != first and any(out.glob("**/*.png")):
                first = time.perf_counter() - began
            time.sleep(0.1)
    seconds = time.perf_counter() - began
    if process.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed with {process.returncode}.")
    return seconds, first if first == first else seconds


def row_of(seconds: float, first: float, out: Path) -> Row:
    """One run of a figure, as a row."""
    results: dict[str, Any] = json.loads((out / "results.json").read_text(encoding="utf-8"))
    compiling, running = results["seconds_compiling"], results["seconds_running"]
    row = harness.spread([seconds]) | {"first_call": seconds, "compiling": compiling}
    return row | {"seconds to a picture": first, "seconds of computing": compiling + running}


def bars(measured: dict[str, float]) -> list[Bar]:
    """A picture within three minutes of nothing; a second run within a third of the first one's compute time."""
    found = [Bar("Fresh clone to a picture, quick form: at most 180 s", measured.get("clone to picture"), 180, True)]
    for form, why in (("quick", _TRACING), ("whole", "running: nine tenths of the first run is no compiling")):
        first, second = measured.get(f"{form}, empty"), measured.get(f"{form}, filled")
        share = second / first if first and second else None
        found.append(Bar(f"A second run, {form}: at most a third of the first's compute time", share, 1 / 3, True, why))
    return found


_TRACING = "running, and tracing in Python, neither of which a cache of compiled programs spares: see `compiling`"


if __name__ == "__main__":
    main(tyro.cli(Options))
