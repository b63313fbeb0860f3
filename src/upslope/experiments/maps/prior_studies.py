"""Experiments that learn priors of grid games: Figures 2 and 4, and studies of Algorithm 1 on maps."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from upslope.experiments.experiment import Experiment, Plan
from upslope.experiments.maps.pictures import draw_map_figures
from upslope.experiments.maps.prior_plots import draw_grid_priors
from upslope.experiments.maps.prior_report import COLUMNS, prior_rows, write_prior_report
from upslope.experiments.maps.priors import run_grid_priors
from upslope.experiments.maps.readings import AIMS, GridPriorsConfig, quick_grid_priors
from upslope.experiments.results import write_json
from upslope.priors.prior import Prior
from upslope.run.session import Session


class LearnedPriors(NamedTuple):
    """The results of such an experiment.

    Attributes:
        config: the settings of the run.
        results: the content of results.json.
        priors: the priors of each reading, one per seed.
        maps: the content of maps.npz.
    """

    config: GridPriorsConfig
    results: dict[str, Any]
    priors: dict[str, list[Prior]]
    maps: dict[str, np.ndarray]


def priors_study(title: str, full: Callable[..., GridPriorsConfig]) -> Experiment[GridPriorsConfig, LearnedPriors]:
    """An experiment that learns priors of grid games.

    Args:
        title: the title of its report.
        full: makes its settings, for a given number of iterations or the default.
    """
    return Experiment(full, quick_grid_priors, _run, partial(_write, title), _summarise, with_iterations=full)


def _run(plan: Plan[GridPriorsConfig], session: Session) -> LearnedPriors:
    results, priors, maps = run_grid_priors(plan.settings, session)
    return LearnedPriors(plan.settings, {"quick": plan.is_quick, **results}, priors, maps)


def _write(title: str, learned: LearnedPriors, folder: Path) -> None:
    config, results, priors, maps = learned
    np.savez_compressed(folder / "maps.npz", allow_pickle=False, **maps)
    write_json(folder / "results.json", results)
    for reading, of_seeds in priors.items():
        for prior in of_seeds:
            prior.save(folder / f"{reading}-{prior.trained_on.seed}.safetensors", overwrite=True)
    aims = {measure: of_maps[config.maps] for measure, of_maps in AIMS.items()}
    draw_grid_priors(results, aims, folder)
    draw_map_figures(config, priors["algorithm1"][0], folder)
    write_prior_report(title, results, aims, folder)


def _summarise(learned: LearnedPriors, folder: Path, console: Console) -> None:
    results = learned.results
    table = Table(*COLUMNS, title=f"Priors on unseen maps ({results['maps']})")
    for what, *numbers in prior_rows(results):
        means = (number.partition(" (")[0] for number in numbers)  # the ranges over seeds are in the report
        table.add_row(what, *means)
    console.print(table)
    console.print(
        f"[bold]{folder / 'report.html'}[/bold] has all results; numbers, priors and pictures are next to it."
    )
