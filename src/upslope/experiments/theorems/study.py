"""The paper's theorems on thousands of maps: what holds, to which precision, and what violates them."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console

from upslope.errors import UpslopeError
from upslope.experiments.experiment import Experiment, Plan
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.results import write_json
from upslope.experiments.theorems.alternation import RATIOS, on_a_network, stable_ratio, tabular
from upslope.experiments.theorems.credit_assignment import credit_assignment
from upslope.experiments.theorems.maps import draw_maps, kinds
from upslope.experiments.theorems.plots import draw_theorems
from upslope.experiments.theorems.policy_invariance import policy_invariance
from upslope.experiments.theorems.tables import tables
from upslope.run.machine import hardware, versions
from upslope.run.observers import Observer
from upslope.run.session import Session
from upslope.tasks import grid_games


@dataclass(frozen=True)
class TheoremsConfig:
    """Settings of the checks.

    Attributes:
        tasks: the number of maps of each kind for Thms. 2.1 and 3.1.
        first_seed: the seed of the maps, of all random numbers on them, and of the first network.
        seeds: the number of networks for Thm. 3.2.
        alternated: the number of maps of each kind for Thm. 3.2 on tables.
        pairs: the number of pairs of Eqs. 8 and 9 on tables.
        updates: the number of pairs of Eqs. 8 and 9 on a network.
        step_size: α on a network.
    """

    tasks: int = 2000
    first_seed: int = 0
    seeds: int = 5
    alternated: int = 400
    pairs: int = 1000
    updates: int = 20_000
    step_size: float = 0.5

    def __post_init__(self) -> None:
        for name, count in asdict(self).items():
            if name != "first_seed" and count <= 0:
                raise UpslopeError(f"{name} is {count}, so there is nothing to check: give a positive number.")


def quick_theorems(config: TheoremsConfig) -> TheoremsConfig:
    """The quick form, a few seconds: tests the code."""
    return replace(config, tasks=50, seeds=2, alternated=20, pairs=200, updates=400)


def theorems(config: TheoremsConfig, observers: Sequence[Observer] = ()) -> dict[str, Any]:
    """Checks Thms. 2.1, 3.1 and 3.2 and returns the content of results.json."""
    start = time.perf_counter()
    seed = config.first_seed
    steps = [*kinds(), "network"]
    results: dict[str, Any] = {"invariance": {}, "credit": {}, "alternation": {}}
    for observer in observers:
        observer.begin("theorems", len(steps), 1)
    try:
        _report(observers, 0, 0.0)
        for number, (name, family) in enumerate(kinds().items()):
            maps, fewer = (draw_maps(family, count, seed) for count in (config.tasks, config.alternated))
            with jax.enable_x64(True):
                results["invariance"][name] = policy_invariance(maps, seed)
                results["credit"][name] = credit_assignment(maps, seed)
                every = max(config.pairs // 50, 1)
                results["alternation"][name] = tabular(fewer, seed, pairs=config.pairs, every=every)
            _report(observers, number + 1, results["credit"][name]["solved"]["V*"])
        small = grid_games((5, 5), flat=True)
        results["network"] = on_a_network(
            small,
            small.sample(key_for(seed, Purpose.TEST_TASKS)),
            seed=seed,
            seeds=config.seeds,
            updates=config.updates,
            every=max(config.updates // 40, 1),
            step_size=config.step_size,
        )
        optimal = [run[-1] for run in results["network"]["ratios"][str(RATIOS[0])]["policy"]]
        _report(observers, len(steps), np.mean(optimal))
    finally:
        for observer in observers:
            observer.end()
    return {
        "experiment": "theorems",
        **results,
        "stable_ratio": {str(gamma): stable_ratio(gamma) for gamma in (0.9, 0.95, 0.98)},
        "seconds": time.perf_counter() - start,
        "configuration": asdict(config),
        "versions": versions(),
        "hardware": hardware(),
    }


def _report(observers: Sequence[Observer], step: int, solved: float | np.floating) -> None:
    for observer in observers:
        observer.record(step, np.asarray([solved]), {}, at=time.time())


def _run(plan: Plan[TheoremsConfig], session: Session) -> dict[str, Any]:
    return theorems(plan.settings, session.observers)


def _write(results: dict[str, Any], folder: Path) -> None:
    write_json(folder / "results.json", results)
    (folder / "tables.md").write_text(tables(results), encoding="utf-8")
    draw_theorems(results, folder)


def _summarise(results: dict[str, Any], folder: Path, console: Console) -> None:
    console.print(tables(results), highlight=False, soft_wrap=True)
    console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold]; the picture is {folder / 'figure.png'}.")


THEOREMS = Experiment(TheoremsConfig, quick_theorems, _run, _write, _summarise)
