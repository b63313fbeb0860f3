"""The paper's figures with panels as experiments: Figure 1 on poles, 3 and 5 on maps."""

from functools import partial
from pathlib import Path

from rich.console import Console

from upslope.experiments.experiment import PANELS, Experiment, Plan
from upslope.experiments.maps.figures import (
    GRID_PANELS,
    GridFigureConfig,
    full_grid_figure,
    grid_figure,
    quick_grid_figure,
    trainings,
)
from upslope.experiments.maps.readings import Maps
from upslope.experiments.plots import draw
from upslope.experiments.poles.figure1 import Figure1Config, figure1, quick
from upslope.experiments.report import print_summary, write_report
from upslope.experiments.results import FigureResult, write_results
from upslope.run.session import Session


def _run_on_poles(plan: Plan[Figure1Config], session: Session) -> FigureResult:
    return figure1(plan.settings, panels=plan.panels, is_quick=plan.is_quick, session=session)


def _run_on_maps(plan: Plan[GridFigureConfig], session: Session) -> FigureResult:
    panels = [panel for panel in GRID_PANELS if panel in plan.panels]
    return grid_figure(plan.settings, panels=panels, is_quick=plan.is_quick, session=session)


def _write(result: FigureResult, folder: Path) -> None:
    write_results(result, folder)
    draw(result, folder)
    write_report(result, folder)


def _summarise(result: FigureResult, folder: Path, console: Console) -> None:
    print_summary(result, console)
    console.print(f"[bold]{folder / 'report.html'}[/bold] has all results; the picture is {folder / 'figure.png'}.")


def _show(result: FigureResult, folder: Path, console: Console) -> None:
    if (folder / "results.json").exists():
        return  # a finished figure that is made again from its checkpoints keeps its whole picture
    draw(result, folder)
    newest = list(result.panels)[-1]
    console.print(f"The {newest} panel is done: {folder / 'figure.png'} shows it.", highlight=False, soft_wrap=True)


FIGURE_1 = Experiment(Figure1Config, quick, _run_on_poles, _write, _summarise, panels=PANELS, show=_show)


def figure_on(maps: Maps) -> Experiment[GridFigureConfig, FigureResult]:
    """Figure 3 on clean maps, or Figure 5 on maps with obstacles; they can reuse the priors of Figure 2 or 4."""
    full = partial(full_grid_figure, maps)
    return Experiment(
        full,
        quick_grid_figure,
        _run_on_maps,
        _write,
        _summarise,
        with_iterations=full,
        panels=GRID_PANELS,
        trainings=lambda settings, panels: trainings(settings.maps, panels),
        show=_show,
    )
