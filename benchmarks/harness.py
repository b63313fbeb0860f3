"""What every benchmark shares: parts timed in turns, bars to reach, and the JSON and the table it all ends in.

A part is a call that does the work once and waits for it. Its first call, which compiles, is reported separately. Then
all parts take turns, so that a machine that slows down slows down all of them.
"""

import atexit
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.provenance import machine, software
from upslope.run.compiling import compile_clock

RESULTS = Path(__file__).parent / "results"

Row = dict[str, Any]


@dataclass(frozen=True)
class Options:
    """What all benchmarks take.

    Attributes:
        repeats: of each part, in turns, after its first call.
        quick: a small form that shows that everything works; its results go to a separate folder and mean nothing.
    """

    repeats: int = 5
    quick: bool = False


@dataclass(frozen=True)
class Part:
    """One thing to time.

    Attributes:
        run: does the work once, and waits for it.
        work: how much is done in one call, by unit: what rates are made from.
    """

    run: Callable[[], object]
    work: Mapping[str, float] = field(default_factory=dict)


class Bar(NamedTuple):
    """A target.

    Attributes:
        what: in words, with the number that is needed.
        measured: None where this run did not measure it.
        needed: the least, or the most.
        at_most: whether less is better.
        bound: what bounds it where it is missed.
        close: whether the bound is reported although the bar is met, because only the margin for noise meets it.
    """

    what: str
    measured: float | None
    needed: float
    at_most: bool = False
    bound: str = ""
    close: bool = False

    @property
    def verdict(self) -> str:
        """Met, or missed and by how much."""
        if self.measured is None:
            return "not measured"
        if (self.measured <= self.needed) if self.at_most else (self.measured >= self.needed):
            return "met"
        ratio = self.measured / self.needed if self.at_most else self.needed / self.measured
        return f"missed by a factor of {ratio:.2f}"


def scratch() -> Path:
    """A new folder that goes when this process ends: for compiled programs, so that no earlier run's are found."""
    folder = tempfile.mkdtemp(prefix="upslope-benchmark-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def time_in_turns(
    parts: Mapping[str, Part], repeats: int, after: Callable[[int], object] = lambda _: None
) -> dict[str, Row]:
    """Every part's first call, then ``repeats`` calls of each in turns.

    Args:
        parts: by name.
        repeats: of each.
        after: called after the first calls and after each turn, with the number of calls that each part has had.

    Returns:
        By name: all ``seconds``, their ``median``, ``fastest`` and ``slowest``, seconds of the ``first_call``, how many
        of those went into ``compiling`` and into how many ``programs``, and a rate for each unit of work.
    """
    rows: dict[str, Row] = {}
    for name, part in parts.items():
        with compile_clock() as clock:
            seconds = seconds_of(part.run)
        rows[name] = {"seconds": [], "first_call": seconds, "compiling": clock.seconds, "programs": clock.programs}
    after(1)
    for turn in range(repeats):
        for name, part in parts.items():
            rows[name]["seconds"].append(seconds_of(part.run))
        after(turn + 2)
    for name, part in parts.items():
        rows[name] |= spread(rows[name]["seconds"])
        rows[name] |= {f"{unit}/s": work / rows[name]["median"] for unit, work in part.work.items()}
    return rows


def seconds_of(run: Callable[[], object]) -> float:
    """Wall-clock seconds of one call."""
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def spread(values: Iterable[float]) -> dict[str, float]:
    """Median, fastest and slowest."""
    values = list(values)
    return {"median": float(np.median(values)), "fastest": min(values), "slowest": max(values)}


def write(
    name: str, options: Options, rows: Mapping[str, Row], *, bars: Iterable[Bar] = (), unit: str = "s", **more: Any
) -> Path:
    """Writes ``results/NAME.json`` with versions, hardware and settings, and prints it as a table."""
    folder = RESULTS / "quick" if options.quick else RESULTS
    folder.mkdir(parents=True, exist_ok=True)
    bars = list(bars)
    content = {
        "rows": rows,
        "unit": unit,
        "bars": [bar._asdict() | {"verdict": bar.verdict} for bar in bars],
        **more,
        "settings": asdict(options),
        "versions": software(),
        "hardware": machine(),
        "written": datetime.now(UTC).replace(microsecond=0).isoformat(),
    }
    path = folder / f"{name}.json"
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    console = Console() if Console().is_terminal else Console(width=180)
    console.print(table_of(name, rows, unit))
    for bar in bars:
        measured = "-" if bar.measured is None else number(bar.measured)
        console.print(f"{bar.what}: {measured}, {bar.verdict}.", highlight=False)
    console.print(f"Written to {path}.", highlight=False)
    return path


def table_of(title: str, rows: Mapping[str, Row], unit: str) -> Table:
    """The rows with all their numbers, lists left out."""
    table = Table(title=title)
    heads, body = cells_of(rows, unit)
    for head in heads:
        table.add_column(head, justify="left" if head == heads[0] else "right")
    for line in body:
        table.add_row(*line)
    return table


def cells_of(rows: Mapping[str, Row], unit: str) -> tuple[list[str], list[list[str]]]:
    """Heads and lines of a table: the median with its range, then each other number that a row has."""
    others = list(dict.fromkeys(key for row in rows.values() for key in row if key not in _SHOWN_TOGETHER))
    heads = ["", f"median, {unit}", f"range, {unit}", *(_HEADS.get(key, key.replace("_", " ")) for key in others)]
    body = []
    for name, row in rows.items():
        span = f"{number(row['fastest'])} to {number(row['slowest'])}" if "fastest" in row else ""
        median = number(row["median"]) if "median" in row else ""
        body.append([name, median, span, *(number(row[key]) if key in row else "" for key in others)])
    return heads, body


_SHOWN_TOGETHER = ("seconds", "values", "median", "fastest", "slowest", "programs")
_HEADS = {"first_call": "first call, s", "compiling": "of it compiling, s"}


def number(value: Any) -> str:
    """Three significant digits with thousands separators; words unchanged."""
    if not isinstance(value, int | float):
        return str(value)
    if value == 0 or not np.isfinite(value):
        return f"{value:g}"
    decimals = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{min(decimals, 6)}f}"


def counted(count: int, noun: str) -> str:
    """A number and its noun."""
    return f"{count:,} {noun}" + ("" if count == 1 else "s")
