"""Folders of runs: one writer each, locked before anything is written, never overwritten."""

import fcntl
import itertools
import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

from upslope.errors import UpslopeError
from upslope.storage import write_atomically

_LOCK = ".lock"
_DESCRIPTION = "run.json"


@contextmanager
def claim(
    folder: Path | None, kind: str, configuration: Mapping[str, Any] | None = None, *, resume: bool = False
) -> Iterator[Path]:
    """Claims a folder for a run: inside the ``with`` block no other process can claim it.

    The kernel releases the lock when the process ends, in whatever way.

    Args:
        folder: the folder; ``runs/<kind>-<date>-<time>`` if None.
        kind: the kind of run.
        configuration: everything that determines the run's results; saved in the folder, and compared when resuming.
        resume: continue the run that is there.

    Raises:
        UpslopeError: the folder is not empty, is in use by another process or can't be made; or there is no run to
            resume, or one with another configuration.
    """
    if resume and folder is None:
        raise UpslopeError("--resume needs to know which run: give its folder with --out.")
    chosen = folder or Path("runs") / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    description = _describe(kind, configuration or {})
    try:
        if resume and not (chosen / _DESCRIPTION).is_file():
            raise UpslopeError(
                f"There is no run in {chosen}: give the folder of one, or start a new run without --resume."
            )
        if not resume:
            _check_empty(chosen)
            chosen.mkdir(parents=True, exist_ok=True)
        with _locked(chosen):
            if resume:
                _check_same(chosen, description)
            else:
                _check_empty(chosen)
                write_atomically(chosen / _DESCRIPTION, (json.dumps(description, indent=1) + "\n").encode())
            yield chosen
    except OSError as error:
        if error.filename is not None and not str(error.filename).startswith(str(chosen)):
            raise
        raise UpslopeError(
            f"{chosen} can't be used as a folder ({error.strerror}): give another one with --out."
        ) from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    with (folder / _LOCK).open("a+", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UpslopeError(
                f"{folder} is in use by {_holder(lock)}: wait until it ends, or give another folder with --out."
            ) from error
        lock.truncate(0)
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {datetime.now():%Y-%m-%d %H:%M:%S}")
        lock.flush()
        yield


def _holder(lock: IO[str]) -> str:
    for _ in range(20):
        lock.seek(0)
        if name := lock.read(200).strip():
            return name
        time.sleep(0.025)  # the name is written a moment after the lock is taken
    return "another process"


def _check_empty(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(entry.name != _LOCK for entry in folder.iterdir())):
        if folder.is_dir() and (folder / _LOCK).is_file():
            with _locked(folder):
                pass
        raise UpslopeError(
            f"{folder} is not empty, and nothing is overwritten: give another folder with --out, move this one away, "
            "or, if it holds a run that was stopped, continue it with --resume."
        )


def _describe(kind: str, configuration: Mapping[str, Any]) -> dict[str, Any]:
    """The content of ``run.json``, after a round trip through JSON, so that it compares."""
    return json.loads(json.dumps({"kind": kind, "version": version("upslope"), "configuration": configuration}))


def _check_same(folder: Path, description: dict[str, Any]) -> None:
    try:
        there = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UpslopeError(
            f"{folder / _DESCRIPTION} can't be read ({error}): start a new run in another folder."
        ) from error
    found = differences(there, description)
    if found:
        raise UpslopeError(
            f"{folder} holds a run with other settings ({summary(found)}): "
            "give the settings that it was started with, or another folder with --out."
        )


#: More differences than this are those of another form of the settings, not of a wrong option.
_MOST_LISTED = 6


def summary(found: list[str]) -> str:
    """The differences in one phrase, all of them or only the first ones."""
    if len(found) <= _MOST_LISTED:
        return "; ".join(found)
    listed = "; ".join(found[:2])
    return f"{listed}; and {len(found) - 2} more: another version of upslope may have started it"


def differences(there: Any, here: Any, name: str = "") -> list[str]:
    """The differences between two JSON values, one phrase for each place."""
    if isinstance(there, dict) and isinstance(here, dict):
        keys = sorted(there.keys() | here.keys())
        return [
            phrase
            for key in keys
            for phrase in differences(there.get(key), here.get(key), f"{name}.{key}" if name else key)
        ]
    if isinstance(there, list) and isinstance(here, list) and any(isinstance(one, dict) for one in (*there, *here)):
        pairs = enumerate(itertools.zip_longest(there, here))
        return [phrase for index, pair in pairs for phrase in differences(*pair, f"{name}[{index}]")]
    return [] if there == here else [f"{name} was {json.dumps(there)}, is now {json.dumps(here)}"]
