"""``python -m reliability [--quick | --long]``: checks that runs survive kills, signals, damaged files and full disks.

Prints a table, and writes ``reliability/results/short.json`` or ``long.json``; the quick form writes nothing.
"""

import functools
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import tyro
from rich.console import Console
from rich.table import Table

from reliability import audit, disk, kills, mutations, race, stops
from reliability.processes import BrokenPromiseError
from reliability.worker import HOST_KINDS, KINDS, PHASES
from upslope.run.compiling import set_up_devices
from upslope.run.machine import hardware, versions

RESULTS = Path(__file__).parent / "results"


class Form(NamedTuple):
    """How thorough a run of all checks is.

    Attributes:
        kinds: of compiled runs that are killed at random moments.
        kills: of those runs.
        host_kills: of runs on Gymnasium environments.
        kills_per_point: at each named point inside a save.
        phases: in which a run is stopped.
        stops_per_phase: in each of them.
        stops_of_a_figure: of the quick Figure 1.
        mutants: of saved files.
    """

    kinds: tuple[str, ...] = KINDS
    kills: int = 50
    host_kills: int = 5
    kills_per_point: int = 1
    phases: tuple[str, ...] = PHASES
    stops_per_phase: int = 2
    stops_of_a_figure: int = 2
    mutants: int = 10_000


SHORT = Form()
LONG = Form(kills=500, host_kills=50, kills_per_point=3, stops_per_phase=20, stops_of_a_figure=20)
QUICK = Form(("dqn",), 3, 0, 1, ("compiling", "running", "saving"), 1, 0, 2_000)


@dataclass(frozen=True)
class Options:
    """How thorough; about fifteen minutes on two cores by default."""

    quick: bool = False
    """A few of each: about three minutes, for CI."""
    long: bool = False
    """Ten times as many kills and signals: about an hour."""
    seed: int = 0
    """Of the moments and mutations."""
    only: str | None = None
    """Run the checks with this in their names; the results of the others stay as they are."""


def main() -> None:
    """Runs the checks one after another; exit code 1 if a promise is broken."""
    options = tyro.cli(Options, description=__doc__)
    form = QUICK if options.quick else LONG if options.long else SHORT
    path = RESULTS / ("long.json" if options.long else "short.json")
    keeps_others = options.only and not options.quick and path.is_file()
    results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["checks"] if keeps_others else {}
    seed = options.seed
    with tempfile.TemporaryDirectory() as text:
        root = Path(text)
        whole = functools.cache(lambda kind: kills.uninterrupted(kind, root))

        def check(name: str, function: Callable[[Path], dict[str, Any]]) -> None:
            if options.only and options.only not in name:
                return
            folder = root / name.replace(" ", "-")
            folder.mkdir()
            began = time.monotonic()
            try:
                results[name] = function(folder) | {"kept": True}
            except BrokenPromiseError as error:
                results[name] = {"kept": False, "what": str(error)}
            results[name]["seconds"] = round(time.monotonic() - began, 1)
            print(f"{name}: {results[name]}", file=sys.stderr, flush=True)

        # Forking comes first, while this process has no threads of JAX's.
        check("simultaneous starts", lambda folder: race.simultaneous(folder, 100))
        set_up_devices()

        def killed(kinds: Sequence[str], count: int) -> Callable[[Path], dict[str, Any]]:
            return lambda folder: kills.at_random_moments(folder, whole, kinds, count, seed)

        check("SIGKILL at random moments", killed(form.kinds, form.kills))
        if form.host_kills:
            check("SIGKILL of runs on the host", killed(HOST_KINDS, form.host_kills))
        check("SIGKILL inside saves", lambda folder: kills.inside_saves(folder, whole("dqn"), form.kills_per_point))
        check(
            "SIGTERM in each phase",
            lambda folder: stops.in_each_phase(folder, whole("dqn"), form.phases, form.stops_per_phase, seed),
        )
        if form.stops_of_a_figure:
            check("SIGTERM amid a figure", lambda folder: stops.during_a_figure(folder, form.stops_of_a_figure, seed))
        check("full disk", lambda folder: disk.full(folder, 16))
        check("damaged and forged files", lambda folder: mutations.mutated(folder, form.mutants, seed))
        check("what loading does", audit.loading)
    if not options.quick:
        RESULTS.mkdir(exist_ok=True)
        entries = {"checks": results, "seed": options.seed, "versions": versions(), "hardware": hardware()}
        path.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    table = Table("check", "kept", "seconds", "what was seen", title="Reliability")
    for name, row in results.items():
        seen = ", ".join(
            f"{key.replace('_', ' ')} {value}" for key, value in row.items() if not isinstance(value, dict)
        )
        table.add_row(name, "yes" if row["kept"] else "NO", str(row["seconds"]), seen)
    Console(width=140).print(table)
    if not all(row["kept"] for row in results.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
