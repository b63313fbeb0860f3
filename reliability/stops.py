"""SIGTERM in each phase of a run and during a figure: it ends within ten seconds and can be resumed."""

import random
import signal
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from reliability.processes import Ending, module, require, resume, work

#: Seconds from the beginning of a phase within which the signal comes.
WITHIN = {"starting": 0.2, "compiling": 4.0, "evaluating": 0.2, "running": 0.3, "saving": 0.01, "ending": 0.0}


def in_each_phase(folder: Path, whole: Ending, phases: Sequence[str], times: int, seed: int) -> dict[str, Any]:
    """Stops a DQN's run ``times`` times in each phase."""
    generator = random.Random(seed)
    cases = [(phase, number, generator.random() * WITHIN[phase]) for phase in phases for number in range(times)]

    def one(case: tuple[str, int, float]) -> tuple[str, float]:
        phase, number, delay = case
        run = folder / f"stop-{phase}-{number}"
        nth = str(1 if phase in ("starting", "compiling", "ending") else 2 + number % 3)
        with tempfile.TemporaryDirectory() as empty:
            # Compiling takes its full time only where nothing is cached.
            cache = Path(empty) if phase == "compiling" else None
            arguments = ("--at", phase, "--deed", "TERM", "--delay", str(delay), "--nth", nth)
            ending = work("dqn", run, *arguments, cache=cache)
        require(ending.code in (0, 143), f"SIGTERM while {phase} ended with {ending.code}: {ending.errors}")
        require(ending.honoured < 10, f"SIGTERM while {phase} took {ending.honoured:.1f} seconds")
        again = resume("dqn", run)
        require(again.digest == whole.digest, f"SIGTERM while {phase} left a run that ends elsewhere: {again.errors}")
        return phase, ending.honoured

    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(one, cases))
    return {
        "signals": len(cases),
        "resumed_to_the_same_sha256": len(cases),
        "longest_seconds_to_the_end": {
            phase: round(max(seconds for name, seconds in done if name == phase), 1) for phase in phases
        },
    }


def during_a_figure(folder: Path, times: int, seed: int) -> dict[str, Any]:
    """Stops the quick Figure 1 ``times`` times, while programs compile in the background too, and lets it end."""
    generator = random.Random(seed)

    def figure(name: str, after: float | None, cache: Path | None = None) -> Ending:
        again = ["--resume"] if (folder / name / "run.json").is_file() else []
        command = ("upslope.cli.main", "reproduce", "fig1", "--quick", "--out", str(folder / name), *again)
        return module(*command, signal_after=(signal.SIGTERM, after), cache=cache)

    longest, stopped = 0.0, 0
    while stopped < times:
        # From the second stop on, some programs are in the cache and some are not.
        ending = figure("stopped", generator.uniform(3.0, 20.0), folder / "cache")
        require(ending.code in (0, 143), f"SIGTERM during a figure ended with {ending.code}: {ending.errors}")
        if ending.code == 0:
            break
        require(ending.honoured < 10, f"SIGTERM during a figure took {ending.honoured:.1f} seconds")
        longest, stopped = max(longest, ending.honoured), stopped + 1
    for name in ("stopped", "whole"):
        ending = figure(name, None)
        require(ending.code == 0, f"the {name} figure ended with {ending.code}: {ending.errors}")
    same = (folder / "stopped/returns.npz").read_bytes() == (folder / "whole/returns.npz").read_bytes()
    require(same, f"a figure stopped {stopped} times has other returns than a whole one")
    return {"stops": stopped, "longest_seconds_to_the_end": round(longest, 1), "returns_of_the_same_bytes": 1}
