"""Which figures there are, and how one is reproduced: run, written, drawn, told."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from upslope.errors import UpslopeError
from upslope.experiments.figure1 import Figure1Config, PanelName, figure1, quick
from upslope.experiments.plots import draw
from upslope.experiments.report import print_summary, write_report
from upslope.experiments.results import FigureResult, write_results
from upslope.run.folder import claim
from upslope.run.observers import EventLog, ProgressBar

FIGURES = ("fig1",)


def reproduce(
    figure: str,
    *,
    out: Path | None = None,
    is_quick: bool = False,
    seeds: int | None = None,
    tasks: int | None = None,
    first_seed: int = 0,
    panels: Sequence[PanelName] = ("left", "middle", "right"),
    console: Console | None = None,
) -> FigureResult:
    """Reproduces a figure of the paper into an empty folder.

    Writes figure.png, figure.pdf, returns.npz, results.json, report.html and logs.

    Args:
        figure: its name.
        out: the folder; a new one under ``runs/`` if None.
        is_quick: the quick form.
        seeds: how many; the paper's if None.
        tasks: how many unseen tasks; the paper's if None.
        first_seed: other seeds and other test tasks.
        panels: of the figure.
        console: where the summary goes.

    Raises:
        UpslopeError: an unknown figure, a folder that holds something, or counts below one.
    """
    if figure not in FIGURES:
        raise UpslopeError(f"There is no figure {figure!r}: choose one of {', '.join(FIGURES)}.")
    config = Figure1Config(first_seed=first_seed)
    config = quick(config) if is_quick else config
    if seeds is not None:
        config = replace(config, seeds=seeds)
    if tasks is not None:
        config = replace(config, tasks=tasks)
    folder = claim(out, figure)
    console = console or Console()
    result = figure1(config, panels=panels, is_quick=is_quick, observers=[ProgressBar(), EventLog(folder / "logs")])
    write_results(result, folder)
    draw(result, folder)
    write_report(result, folder)
    print_summary(result, console)
    console.print(f"[bold]{folder / 'report.html'}[/bold] tells it all; the picture is {folder / 'figure.png'}.")
    return result
