"""How long a user waits for Figure 1, and what its parts cost once compiled.

``python -m benchmarks.first_figure [--whole]`` writes ``benchmarks/results/first_figure.json``.
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

import jax
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from upslope.agents.dqn import DQN, DQNConfig
from upslope.meta_training import MetaTraining
from upslope.potentials import mean_potential, stack
from upslope.recipes import MetaTrainingConfig
from upslope.run.compiling import compile_clock, set_up_devices
from upslope.run.loop import broadcast, run
from upslope.run.machine import hardware, versions
from upslope.shaping import potential_based
from upslope.tasks import cartpoles

RESULTS = Path(__file__).parent / "results" / "first_figure.json"


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 5
    """Of each part, after one run that compiles."""
    whole: bool = False
    """Also the whole figure from an empty compilation cache, and its quick form from an empty and a filled one."""


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    set_up_devices(Path(tempfile.mkdtemp()))
    parts = {
        "Algorithm 1, 1 seed (500 iterations × 10 tasks)": algorithm1(1),
        "Algorithm 1, 5 seeds": algorithm1(5),
        "DQN, 200 learners × 3000 updates, shaped by a mean of 5 priors": dqn_learners(),
    }
    compiling = {name: _compile_seconds(part) for name, part in parts.items()}
    seconds: dict[str, list[float]] = {name: [] for name in parts}
    for _ in range(options.repeats):
        for name, part in parts.items():
            began = time.perf_counter()
            part()
            seconds[name].append(time.perf_counter() - began)
    rows = {name: _row(times) | {"compiling": compiling[name]} for name, times in seconds.items()}
    if options.whole:
        rows |= whole_figure(["--quick"], ("cold", "warm"))
        rows |= whole_figure([], ("cold",))
    RESULTS.parent.mkdir(exist_ok=True)
    content = {"rows": rows, "repeats": options.repeats, "versions": versions(), "hardware": hardware()}
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    _print(rows)


def algorithm1(seeds: int) -> Callable[[], object]:
    """Algorithm 1 with the default settings, snapshots and their trials included."""
    config = MetaTrainingConfig()
    learners = broadcast(MetaTraining(cartpoles(), config), (seeds,))
    keys = jax.random.split(jax.random.key(0), seeds)
    return lambda: run(learners, keys, updates=config.iterations, every=config.snapshot_every)


def dqn_learners() -> Callable[[], object]:
    """200 shaped DQN learners with the figure's settings, evaluated every 100 updates."""
    family, count = cartpoles(), 200
    tasks = family.sample_many(jax.random.key(1), count)
    network = MetaTraining(family).init(jax.random.key(2)).theta
    shaping = broadcast(potential_based(mean_potential(stack([network] * 5))), (count,))
    learners = DQN(family, tasks, shaping, DQNConfig(decay_updates=3000))
    keys = jax.random.split(jax.random.key(3), count)
    return lambda: run(learners, keys, updates=3000, every=100)


def whole_figure(arguments: list[str], states: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """The command as a user types it, as a process of its own; the cache that a cold run fills warms the next."""
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for state in states:
            out = str(Path(folder) / state)
            command = [sys.executable, "-m", "upslope.cli", "reproduce", "fig1", *arguments, "--out", out]
            began = time.perf_counter()
            environment = os.environ | {"UPSLOPE_CACHE": str(Path(folder) / "cache")}
            subprocess.run(command, check=True, capture_output=True, env=environment)
            name = " ".join(["upslope reproduce fig1", *arguments, f"({state} cache)"])
            results = json.loads((Path(out) / "results.json").read_text(encoding="utf-8"))
            rows[name] = _row([time.perf_counter() - began]) | {"compiling": results["seconds_compiling"]}
    return rows


def _compile_seconds(part: Callable[[], object]) -> float:
    with compile_clock() as clock:
        part()
    return clock.seconds


def _row(times: list[float]) -> dict[str, float]:
    return {"median": float(np.median(times)), "fastest": min(times), "slowest": max(times)}


def _print(rows: dict[str, dict[str, float]]) -> None:
    table = Table("", "seconds", "range", "of it, or before it, compiling", title="What a user waits for")
    for name, row in rows.items():
        span = f"{row['fastest']:.1f} to {row['slowest']:.1f}"
        table.add_row(name, f"{row['median']:.1f}", span, f"{row['compiling']:.1f}")
    Console().print(table)
    print(f"Written to {RESULTS}.")


if __name__ == "__main__":
    main(tyro.cli(Options))
