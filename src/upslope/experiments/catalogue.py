"""Which experiments there are, and how one is reproduced: run, written, drawn, told."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from upslope.errors import UpslopeError
from upslope.experiments.figure1 import Figure1Config, PanelName, figure1, quick
from upslope.experiments.grid_figures import (
    GridFigureConfig,
    GridPanelName,
    grid_figure,
    quick_grid_figure,
    stages,
    with_iterations,
)
from upslope.experiments.grid_prior_plots import TITLES, draw_grid_priors
from upslope.experiments.grid_priors import (
    AIMS,
    GridPriorsConfig,
    grid_precisions,
    grid_priors,
    grid_readings,
    quick_grid_priors,
    run_grid_priors,
)
from upslope.experiments.map_figures import draw_map_figures
from upslope.experiments.plots import draw
from upslope.experiments.report import print_summary, write_report
from upslope.experiments.results import FigureResult, write_results
from upslope.experiments.shipped_prior import ShippedPriorConfig, card, quick_shipped_prior, shipped_prior
from upslope.experiments.studies import STUDIES, Study
from upslope.experiments.theorem_plots import draw_theorems
from upslope.experiments.theorems import TheoremsConfig, quick_theorems, tables, theorems
from upslope.run.checkpoints import adopt
from upslope.run.folder import claimed
from upslope.run.session import session_in
from upslope.storage import write_atomically

#: Experiments that learn priors of grid games: the paper's Figures 2 and 4, and two studies.
GRID_PRIORS: dict[str, Callable[..., GridPriorsConfig]] = {
    "fig2": partial(grid_priors, "clean"),
    "fig4": partial(grid_priors, "obstacles"),
    "grid-readings": grid_readings,
    "grid-precisions": grid_precisions,
}
#: The paper's Figures 3 and 5.
GRID_FIGURES: dict[str, Callable[[], GridFigureConfig]] = {
    "fig3": partial(GridFigureConfig, "clean"),
    "fig5": partial(GridFigureConfig, "obstacles"),
}
EXPERIMENTS = ("fig1", *sorted({*GRID_PRIORS, *GRID_FIGURES}), "theorems", "shipped-prior", *STUDIES)
PANELS: tuple[PanelName, ...] = ("left", "middle", "right")


def reproduce(
    experiment: str,
    *,
    out: Path | None = None,
    is_quick: bool = False,
    seeds: int | None = None,
    tasks: int | None = None,
    first_seed: int = 0,
    panels: Sequence[PanelName] = PANELS,
    iterations: int | None = None,
    priors_of: Path | None = None,
    resume: bool = False,
    console: Console | None = None,
) -> None:
    """Runs an experiment into an empty folder, and sums it up on the console.

    Args:
        experiment: one of `EXPERIMENTS`: a figure of the paper, its theorems, or a study.
        out: the folder; a new one under ``runs/`` if None.
        is_quick: the quick form.
        seeds: how many; the experiment's own number if None.
        tasks: how many unseen tasks; the experiment's own number if None.
        first_seed: other seeds and other test tasks.
        panels: of the figure; maps have no middle one.
        iterations: of meta-training, where maps are learned over; the recipe's own number if None.
        priors_of: folder of fig2 (for fig3) or fig4 (for fig5), whose priors are taken instead of trained anew.
        resume: go on with the run in ``out``, started with the same settings.
        console: where the summary goes.

    Raises:
        UpslopeError: an unknown experiment or panel, a folder that holds something (or, to be resumed,
            no such run), or counts below one.
    """
    if experiment not in EXPERIMENTS:
        raise UpslopeError(f"There is no figure {experiment!r}: choose one of {', '.join(EXPERIMENTS)} or all.")
    if not panels or not set(panels) <= set(PANELS):
        raise UpslopeError(f"There are no panels {', '.join(panels)!r}: choose among {', '.join(PANELS)}.")
    if iterations is not None and experiment not in (*GRID_PRIORS, *GRID_FIGURES):
        raise UpslopeError(f"{experiment} has a fixed number of iterations: leave --iterations out.")
    if priors_of is not None and experiment not in GRID_FIGURES:
        raise UpslopeError(f"{experiment} takes no priors of another figure: leave --priors-of out.")
    for name, count in (("seeds", seeds), ("tasks", tasks), ("iterations", iterations)):
        if count is not None and count < 1:
            raise UpslopeError(f"{count} {name} make no figure: give at least 1.")
    console = console or Console()
    if experiment == "fig1":
        config = quick(Figure1Config()) if is_quick else Figure1Config()
        config = replace(config, first_seed=first_seed, seeds=seeds or config.seeds, tasks=tasks or config.tasks)
        make = partial(figure1, config, panels=panels, is_quick=is_quick)
        _reproduce_figure("fig1", {"panels": panels, **asdict(config)}, make, out, resume, console)
    elif experiment in GRID_FIGURES:
        figure = GRID_FIGURES[experiment]()
        figure = figure if iterations is None else with_iterations(figure, iterations)
        figure = quick_grid_figure(figure) if is_quick else figure
        figure = replace(figure, first_seed=first_seed, seeds=seeds or figure.seeds, tasks=tasks or figure.tasks)
        shown: list[GridPanelName] = [name for name in panels if name != "middle"]
        if not shown:
            raise UpslopeError(f"{experiment} has no middle panel: choose left, right or both.")
        make = partial(grid_figure, figure, panels=shown, is_quick=is_quick)
        taken = None if priors_of is None else partial(adopt, stages(figure.maps), priors_of)
        _reproduce_figure(experiment, {"panels": shown, **asdict(figure)}, make, out, resume, console, taken)
    elif experiment == "theorems":
        proofs = quick_theorems(TheoremsConfig()) if is_quick else TheoremsConfig()
        proofs = replace(proofs, first_seed=first_seed, seeds=seeds or proofs.seeds, tasks=tasks or proofs.tasks)
        _reproduce_theorems(proofs, out, resume, console)
    elif experiment == "shipped-prior":
        shipped = quick_shipped_prior(ShippedPriorConfig()) if is_quick else ShippedPriorConfig()
        shifted = shipped.first_seed + first_seed
        shipped = replace(shipped, first_seed=shifted, seeds=seeds or shipped.seeds, tasks=tasks or shipped.tasks)
        _reproduce_shipped_prior(shipped, out, resume, console)
    elif experiment in GRID_PRIORS:
        study_of_priors = GRID_PRIORS[experiment](**({} if iterations is None else {"iterations": iterations}))
        study_of_priors = quick_grid_priors(study_of_priors) if is_quick else study_of_priors
        study_of_priors = replace(
            study_of_priors,
            first_seed=first_seed,
            seeds=seeds or study_of_priors.seeds,
            tasks=tasks or study_of_priors.tasks,
        )
        _reproduce_grid_priors(experiment, study_of_priors, out, resume, console)
    else:
        study = STUDIES[experiment]
        settings = study.quick(study.config()) if is_quick else study.config()
        # Studies that tune have seeds of their own to start from.
        shifted = settings.first_seed + first_seed
        settings = replace(settings, first_seed=shifted, seeds=seeds or settings.seeds, tasks=tasks or settings.tasks)
        _reproduce_study(experiment, study, settings, out, resume, console)


def _reproduce_figure(
    name: str,
    settings: dict[str, Any],
    make: Callable[..., FigureResult],
    out: Path | None,
    resume: bool,
    console: Console,
    prepare: Callable[[Path], None] | None = None,
) -> None:
    with claimed(out, name, settings, resume=resume) as folder:
        if prepare is not None:
            prepare(folder)
        result = make(session=session_in(folder, resume=resume or prepare is not None, final_states=False))
        write_results(result, folder)
        draw(result, folder)
        write_report(result, folder)
    print_summary(result, console)
    console.print(f"[bold]{folder / 'report.html'}[/bold] tells it all; the picture is {folder / 'figure.png'}.")


def _reproduce_study(name: str, study: Study, config: Any, out: Path | None, resume: bool, console: Console) -> None:
    with claimed(out, name, asdict(config), resume=resume) as folder:
        results = study.run(config, session_in(folder, resume=resume, final_states=False))
        write_atomically(folder / "results.json", (json.dumps(results, indent=1) + "\n").encode())
    console.print(study.table(results))
    console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold].")


def _reproduce_theorems(config: TheoremsConfig, out: Path | None, resume: bool, console: Console) -> None:
    with claimed(out, "theorems", asdict(config), resume=resume) as folder:
        results = theorems(config, session_in(folder, resume=resume).observers)
        write_atomically(folder / "results.json", (json.dumps(results, indent=1) + "\n").encode())
        (folder / "tables.md").write_text(tables(results), encoding="utf-8")
        draw_theorems(results, folder)
    console.print(tables(results), highlight=False, soft_wrap=True)
    console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold]; the picture is {folder / 'figure.png'}.")


def _reproduce_shipped_prior(config: ShippedPriorConfig, out: Path | None, resume: bool, console: Console) -> None:
    with claimed(out, "shipped-prior", asdict(config), resume=resume) as folder:
        prior, results = shipped_prior(config, session_in(folder, resume=resume, final_states=False))
        prior.save(folder / "cartpole.safetensors", overwrite=resume)
        results["sha256"] = sha256((folder / "cartpole.safetensors").read_bytes()).hexdigest()
        write_atomically(folder / "cartpole.json", (json.dumps(results, indent=1) + "\n").encode())
        write_atomically(folder / "cartpole.md", card(prior, results).encode())
    console.print(card(prior, results), highlight=False, soft_wrap=True)
    console.print(f"The prior, its card and its numbers are in [bold]{folder}[/bold].")


def _reproduce_grid_priors(
    name: str, config: GridPriorsConfig, out: Path | None, resume: bool, console: Console
) -> None:
    with claimed(out, name, asdict(config), resume=resume) as folder:
        results, priors = run_grid_priors(config, session_in(folder, resume=resume, final_states=False))
        write_atomically(folder / "results.json", (json.dumps(results, indent=1) + "\n").encode())
        for reading, of_seeds in priors.items():
            for prior in of_seeds:
                prior.save(folder / f"{reading}-{prior.trained_on.seed}.safetensors", overwrite=resume)
        draw_grid_priors(results, {measure: aims[config.maps] for measure, aims in AIMS.items()}, folder)
        draw_map_figures(config, priors["algorithm1"][0], folder)
    console.print(_grid_priors_table(results))
    console.print(f"All numbers are in [bold]{folder / 'results.json'}[/bold], the priors and pictures beside it.")


def _grid_priors_table(results: dict[str, Any]) -> Table:
    table = Table("", "seconds", *TITLES.values(), title=f"Priors on unseen maps ({results['maps']})")
    for row in results["readings"].values():
        numbers = (f"{sum(row['final'][measure]) / len(row['chosen']):.3g}" for measure in TITLES)
        table.add_row(row["what"], f"{row['seconds'][-1]:.0f}", *numbers)
    return table
