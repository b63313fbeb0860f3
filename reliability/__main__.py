"""``python -m reliability [--long]``: all checks, a table, and ``reliability/results/short.json`` or ``long.json``."""

import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from reliability import audit, disk, kills, mutations, race, stops
from reliability.processes import BrokenPromiseError
from upslope.run.compiling import set_up_devices
from upslope.run.machine import hardware, versions

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Options:
    """How thorough."""

    long: bool = False
    """500 kills and 20 signals per phase instead of 50 and 2: about an hour."""
    seed: int = 0
    """Of the moments and mutations."""


def main() -> None:
    """Runs the checks one after another; exit code 1 if a promise is broken."""
    options = tyro.cli(Options, description=__doc__)
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as text:
        root = Path(text)

        def check(name: str, function: Callable[..., dict[str, Any]], *arguments: Any) -> None:
            folder = root / name.replace(" ", "-")
            folder.mkdir()
            began = time.monotonic()
            try:
                results[name] = function(folder, *arguments) | {"kept": True}
            except BrokenPromiseError as error:
                results[name] = {"kept": False, "what": str(error)}
            results[name]["seconds"] = round(time.monotonic() - began, 1)
            print(f"{name}: {results[name]}", file=sys.stderr, flush=True)

        # Forking comes first, while this process has no threads of JAX's.
        check("simultaneous starts", race.simultaneous, 100)
        set_up_devices()
        wholes = {kind: kills.uninterrupted(kind, root) for kind in kills.KINDS}
        count, times = (500, 20) if options.long else (50, 2)
        check("SIGKILL at random moments", kills.at_random_moments, wholes, count, options.seed)
        check("SIGKILL inside saves", kills.inside_saves, wholes["dqn"], 3 if options.long else 1)
        check("SIGTERM in each phase", stops.in_each_phase, wholes["dqn"], times, options.seed)
        check("full disk", disk.full, 16)
        check("damaged and forged files", mutations.mutated, 10_000, options.seed)
        check("what loading does", audit.loading)
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / ("long.json" if options.long else "short.json")
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
