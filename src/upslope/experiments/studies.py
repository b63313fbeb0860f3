"""Studies in addition to the paper's figures, each with the table that summarises it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from upslope.experiments.experiment import Experiment, Settings
from upslope.experiments.families.recipe_study import RecipeConfig, quick_recipe, recipe_study
from upslope.experiments.maps import learners as on_maps
from upslope.experiments.poles import learners as on_poles
from upslope.experiments.poles.deviations import DeviationsConfig, deviations, quick_deviations
from upslope.experiments.results import write_json
from upslope.experiments.step_ratio import StepRatioConfig, quick_step_ratio, step_ratio
from upslope.run.session import Session


def study(
    full: Callable[[], Settings],
    quick: Callable[[Settings], Settings],
    run: Callable[[Settings, Session], dict[str, Any]],
    table: Callable[[dict[str, Any]], Table],
) -> Experiment[Settings, dict[str, Any]]:
    """An experiment that writes one file and is summarised by one table.

    Args:
        full: makes the full form's settings.
        quick: makes the quick form's settings from the full form's.
        run: returns the content of results.json.
        table: makes the table from that content.
    """

    def summarise(results: dict[str, Any], folder: Path, console: Console) -> None:
        console.print(table(results))
        console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold].")

    return Experiment(full, quick, lambda plan, session: run(plan.settings, session), _write, summarise)


def _write(results: dict[str, Any], folder: Path) -> None:
    write_json(folder / "results.json", results)


def _deviations_table(results: dict[str, Any]) -> Table:
    table = Table("", "changed", "median", "lowest", "≥ 195", "spread of V", title="Zero-shot return of the priors")
    for name, row in results["variants"].items():
        good = f"{row['at_least_195']} of {len(row['zero_shot'])}"
        numbers = (f"{row['median']:.0f}", f"{row['zero_shot'][0]:.0f}", good, f"{row['value_spread_median']:.2f}")
        table.add_row(name, row["what"], *numbers)
    return table


def _learners_table(results: dict[str, Any]) -> Table:
    arms = on_poles.ARMS
    table = Table("settings", *arms, "prior: lower quartile at end", title="Mean return over all evaluations")
    for name, row in results["variants"].items():
        means = (f"{row['arms'][arm]['mean_over_evaluations']:.0f}" for arm in arms)
        table.add_row(name, *means, f"{row['arms']['prior']['q1'][-1]:.0f}")
    return table


def _grid_learners_table(results: dict[str, Any]) -> Table:
    arms = on_maps.ARMS
    table = Table("settings", *arms, "mean of the arms", title="Mean success over all evaluations")
    for name, row in results["variants"].items():
        means = [row["arms"][arm]["mean_over_evaluations"] for arm in arms]
        table.add_row(name, *(f"{mean:.3f}" for mean in means), f"{sum(means) / len(means):.3f}")
    return table


def _step_ratio_table(results: dict[str, Any]) -> Table:
    table = Table("", "ratio", "step size", "mean", "end", "lower quartile at end", title="Algorithm 2 on other tasks")
    for family, row in results["variants"].items():
        for ratio, arm in row["arms"].items():
            ends = (f"{arm[line][-1]:.3g}" for line in ("iqm", "q1"))
            table.add_row(family, ratio, f"{arm['step_size']:g}", f"{arm['mean_over_evaluations']:.3g}", *ends)
    return table


def _recipe_table(results: dict[str, Any]) -> Table:
    table = Table("family", "changed", "mean return of each seed", "solved", title="Zero-shot return of the priors")
    for family, variants in results["families"].items():
        for row in variants.values():
            means = ", ".join(f"{mean:.3g}" for mean in row["means"])
            table.add_row(family, row["what"], means, f"{sum(row['solved']) / len(row['solved']):.2f}")
    return table


STUDIES: dict[str, Experiment[Any, dict[str, Any]]] = {
    "deviations": study(DeviationsConfig, quick_deviations, deviations, _deviations_table),
    "learners": study(on_poles.LearnersConfig, on_poles.quick_learners, on_poles.learners, _learners_table),
    "grid-learners": study(
        on_maps.GridLearnersConfig,
        on_maps.quick_grid_learners,
        on_maps.grid_learners,
        _grid_learners_table,
    ),
    "recipe": study(RecipeConfig, quick_recipe, recipe_study, _recipe_table),
    "step-ratio": study(StepRatioConfig, quick_step_ratio, step_ratio, _step_ratio_table),
}
