"""Where the time goes when Algorithm 1 trains on Gymnasium environments.

``python -m benchmarks.host_meta_training`` writes ``benchmarks/results/host_meta_training.json``.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import jax
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from upslope import GymnasiumTasks, MetaTrainingConfig
from upslope.meta_training import MetaTraining
from upslope.run.loop import broadcast, run
from upslope.run.machine import hardware, versions

RESULTS = Path(__file__).parent / "results" / "host_meta_training.json"

#: Gymnasium's own CartPole, and ours with the same physics, whose step costs a third of it.
NAMES = ("CartPole-v1", "upslope/CartPole-v0")


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 5
    """Of each environment, in turns, after one run that compiles."""
    iterations: int = 30
    """Meta-iterations of a run, of 10 tasks × 200 steps each."""


def main(options: Options) -> None:
    """Times the runs, and writes the share of the time that was spent in the environments."""
    rows: dict[str, dict[str, list[float]]] = {name: {"seconds": [], "share in environments": []} for name in NAMES}
    for repeat in range(options.repeats + 1):
        for name in NAMES:
            seconds, share = train(name, options.iterations)
            if repeat:
                rows[name]["seconds"].append(seconds)
                rows[name]["share in environments"].append(share)
    table = Table("", "seconds", "share in environments", title=f"{options.iterations} iterations of Algorithm 1")
    for name, row in rows.items():
        table.add_row(name, *(f"{np.median(values):.2f}" for values in row.values()))
    content = {"rows": rows, "iterations": options.iterations, "versions": versions(), "hardware": hardware()}
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    Console().print(table)
    print(f"Written to {RESULTS}.")


def train(name: str, iterations: int) -> tuple[float, float]:
    """Seconds of a run without compiling and without its reports, and the share of them inside environments."""
    family = GymnasiumTasks(lambda rng: float(rng.uniform(0.25, 5.0)), lambda length: made(name, length), 0.98)
    config = MetaTrainingConfig(evaluation_tasks=1, evaluation_episodes=1)
    learners = broadcast(MetaTraining(family, config), (1,))
    began = time.perf_counter()
    outcome = run(learners, jax.random.key(0)[None], updates=iterations, every=iterations)
    seconds = time.perf_counter() - began - outcome.seconds_compiling
    return seconds, family.environments.seconds / seconds


def made(name: str, length: float) -> gym.Env:
    """A CartPole of this full length, with everything that follows from the length."""
    if name.startswith("upslope"):
        return gym.make(name, length=length)
    env = gym.make(name, max_episode_steps=200)
    pole = env.unwrapped
    pole.length, pole.masspole = length / 2, 0.1 * length  # type: ignore[attr-defined]
    pole.total_mass = pole.masscart + pole.masspole  # type: ignore[attr-defined]
    pole.polemass_length = pole.masspole * pole.length  # type: ignore[attr-defined]
    return env


if __name__ == "__main__":
    main(tyro.cli(Options))
