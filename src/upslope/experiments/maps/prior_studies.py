"""Experiments that learn priors of grid games: Figures 2 and 4, and studies of Algorithm 1 there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from upslope.experiments.experiment import Experiment, Plan
from upslope.experiments.maps.pictures import draw_map_figures
from upslope.experiments.maps.prior_plots import TITLES, draw_grid_priors
from upslope.experiments.maps.priors import run_grid_priors
from upslope.experiments.maps.readings import AIMS, GridPriorsConfig, quick_grid_priors
from upslope.experiments.results import write_json
from upslope.prior import Prior
from upslope.run.session import Session


class LearnedPriors(NamedTuple):
    """What such an experiment comes to.

    Attributes:
        config: it was run with.
        results: the content of results.json.
        priors: of each reading, one per seed.
    """

    config: GridPriorsConfig
    results: dict[str, Any]
    priors: dict[str, list[Prior]]


def priors_study(full: Callable[..., GridPriorsConfig]) -> Experiment[GridPriorsConfig, LearnedPriors]:
    """The experiment whose settings this makes, for any number of iterations or its own."""
    return Experiment(full, quick_grid_priors, _run, _write, _tell, with_iterations=full)


def _run(plan: Plan[GridPriorsConfig], session: Session) -> LearnedPriors:
    return LearnedPriors(plan.settings, *run_grid_priors(plan.settings, session))


def _write(learned: LearnedPriors, folder: Path) -> None:
    config, results, priors = learned
    write_json(folder / "results.json", results)
    for reading, of_seeds in priors.items():
        for prior in of_seeds:
            prior.save(folder / f"{reading}-{prior.trained_on.seed}.safetensors", overwrite=True)
    draw_grid_priors(results, {measure: aims[config.maps] for measure, aims in AIMS.items()}, folder)
    draw_map_figures(config, priors["algorithm1"][0], folder)


def _tell(learned: LearnedPriors, folder: Path, console: Console) -> None:
    results = learned.results
    table = Table("", "seconds", *TITLES.values(), title=f"Priors on unseen maps ({results['maps']})")
    for row in results["readings"].values():
        numbers = (f"{sum(row['final'][measure]) / len(row['chosen']):.3g}" for measure in TITLES)
        table.add_row(row["what"], f"{row['seconds'][-1]:.0f}", *numbers)
    console.print(table)
    console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold], the priors and pictures beside it.")
