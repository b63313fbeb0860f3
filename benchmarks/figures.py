"""How long the quick forms of the figures on maps take, and those of everything, with an empty and with a filled cache.

``python -m benchmarks.figures`` writes ``benchmarks/results/figures.json``.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import tyro

from benchmarks import harness
from benchmarks.harness import Bar, Row

ROOT = Path(__file__).parents[1]
STATES = ("empty cache", "filled cache")

#: The issue's limit for the quick forms of these.
ON_MAPS, LIMIT = ("fig2", "fig3", "fig4", "fig5"), 600


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        repeats: of each, both states of the cache in each.
        figures: what is reproduced.
    """

    repeats: int = 1
    figures: tuple[str, ...] = (*ON_MAPS, "all")


def main(options: Options) -> None:
    """Runs the commands as a user types them, one after the other."""
    if options.quick:
        options = replace(options, repeats=1, figures=ON_MAPS[:1])
    seconds: dict[str, list[float]] = {}
    for _ in range(options.repeats):
        for figure in options.figures:
            for state, taken in zip(STATES, reproduced(figure), strict=True):
                seconds.setdefault(f"upslope reproduce {figure} --quick ({state})", []).append(taken)
    rows: dict[str, Row] = {name: harness.spread(taken) | {"seconds": taken} for name, taken in seconds.items()}
    harness.write("figures", options, rows, bars=[bar(rows)])


def reproduced(figure: str) -> list[float]:
    """Seconds of two processes that share a cache folder, which the first finds empty."""
    taken = []
    with tempfile.TemporaryDirectory() as text:
        environment = os.environ | {"UPSLOPE_CACHE": str(Path(text) / "cache")}
        for state in STATES:
            out = str(Path(text) / state)
            command = [sys.executable, "-m", "upslope.cli.main", "reproduce", figure, "--quick", "--out", out]
            taken.append(
                harness.seconds_of(
                    partial(subprocess.run, command, cwd=ROOT, env=environment, check=True, capture_output=True)
                )
            )
    return taken


def bar(rows: dict[str, Row]) -> Bar:
    """All quick forms on maps, each from an empty cache."""
    names = [f"upslope reproduce {figure} --quick ({STATES[0]})" for figure in ON_MAPS]
    total = sum(rows[name]["median"] for name in names) if all(name in rows for name in names) else None
    what = f"Quick forms of {', '.join(ON_MAPS)} together, each from an empty cache: at most {LIMIT} s"
    return Bar(what, total, LIMIT, at_most=True, bound="running: see the rows with a filled cache")


if __name__ == "__main__":
    main(tyro.cli(Options))
