"""Starts workers, waits for them, and reports how they ended."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Ending(NamedTuple):
    """How a worker ended.

    Attributes:
        code: its exit code; negative for a signal.
        seconds: that it ran.
        digest: what it printed, if it finished.
        errors: what it said last.
        honoured: seconds from the signal, if there was one, to its end.
    """

    code: int
    seconds: float
    digest: str
    errors: str
    honoured: float


class BrokenPromiseError(AssertionError):
    """A promise that was not kept."""


def require(kept: bool, what: str) -> None:
    """Raises `BrokenPromiseError` unless a promise was kept."""
    if not kept:
        raise BrokenPromiseError(what)


def work(
    kind: str, folder: Path, *arguments: str, kill_after: float | None = None, cache: Path | None = None
) -> Ending:
    """Runs one worker to its end, or kills it after some seconds; with its own compilation cache if one is given."""
    command = ("reliability.worker", kind, str(folder), *arguments)
    return module(*command, signal_after=(signal.SIGKILL, kill_after), cache=cache)


def module(*command: str, signal_after: tuple[int, float | None], cache: Path | None = None) -> Ending:
    """Runs ``python -m`` with a command to its end, or sends it a signal after some seconds and waits for its end."""
    began = time.monotonic()
    environment = os.environ | ({} if cache is None else {"UPSLOPE_CACHE": str(cache)})
    process = subprocess.Popen(
        (sys.executable, "-m", *command),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=ROOT,
    )
    number, after = signal_after
    sent = 0.0
    try:
        output, errors = process.communicate(timeout=after)
    except subprocess.TimeoutExpired:
        sent = time.time()
        process.send_signal(number)
        output, errors = process.communicate()
    reported = re.search(r"signalled at ([0-9.]+)", errors)
    sent = float(reported[1]) if reported else sent
    honoured = time.time() - sent if sent else 0.0
    return Ending(process.returncode, time.monotonic() - began, output.strip(), errors.strip()[-2000:], honoured)


def resume(kind: str, folder: Path, *arguments: str, kill_after: float | None = None) -> Ending:
    """Resumes a run; starts it if it has no folder yet."""
    there = (folder / "run.json").is_file()
    return work(kind, folder, *(["--resume"] if there else []), *arguments, kill_after=kill_after)
