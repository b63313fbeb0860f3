"""What the commands that run something have in common: settings that decide the results, and a table of returns."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from upslope.errors import UpslopeError
from upslope.learners.curve import LearningCurve


def settings_of(command: Any) -> dict[str, Any]:
    """The settings that decide a command's results: all but the folder, and whether a run is continued."""
    settings = asdict(command, dict_factory=_with_paths_as_text)
    return {name: value for name, value in settings.items() if name not in ("out", "resume")}


def _with_paths_as_text(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return {name: str(value) if isinstance(value, Path) else value for name, value in pairs}


def check_counts(**counts: int) -> None:
    """Checks numbers of updates, before a folder is made.

    Raises:
        UpslopeError: one is below 1.
    """
    for name, count in counts.items():
        if count < 1:
            raise UpslopeError(f"{count} {name} can't be run: give --{name} at least 1.")


def print_returns(title: str, curve: LearningCurve) -> None:
    """A table of the raw greedy returns."""
    table = Table("updates", "raw greedy return", title=title, title_justify="left")
    for update, value in zip(curve.updates, curve.returns, strict=True):
        table.add_row(str(update), f"{value:.1f}")
    Console().print(table)
