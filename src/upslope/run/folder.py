"""Folders of runs: one writer each, claimed before anything is written, never overwritten."""

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
def claimed(
    folder: Path | None, kind: str, configuration: Mapping[str, Any] | None = None, *, resume: bool = False
) -> Iterator[Path]:
    """A folder for a run, with nobody else writing to it.

    The lock is the kernel's: it goes with the process, however that ends.

    Args:
        folder: where to; ``runs/<kind>-<date>-<time>`` if None.
        kind: what kind of run it is.
        configuration: what decides the run's results; kept in the folder, and compared on resuming.
        resume: go on with the run that is there.

    Raises:
        UpslopeError: the folder holds something already, is in use by another process or can't be made; or, to be
            resumed, it holds no run, or one of another configuration.
    """
    if resume and folder is None:
        raise UpslopeError("Nothing says which run to resume: give its folder with --out.")
    chosen = folder or Path("runs") / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    description = _described(kind, configuration or {})
    try:
        if resume and not (chosen / _DESCRIPTION).is_file():
            raise UpslopeError(f"There is no run in {chosen}: give the folder of one, or start anew without --resume.")
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
            f"{chosen} can't be used as a folder ({error.strerror}): give another with --out."
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
        time.sleep(0.025)  # it is written a moment after the lock is taken
    return "another process"


def _check_empty(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(entry.name != _LOCK for entry in folder.iterdir())):
        if folder.is_dir() and (folder / _LOCK).is_file():
            with _locked(folder):
                pass
        raise UpslopeError(
            f"{folder} already holds something, and nothing is overwritten: give another folder with --out, "
            "move that one away, or, if it holds a run that was stopped, go on with it by --resume."
        )


def _described(kind: str, configuration: Mapping[str, Any]) -> dict[str, Any]:
    """As it looks after a round trip through JSON, so that it compares."""
    return json.loads(json.dumps({"kind": kind, "version": version("upslope"), "configuration": configuration}))


def _check_same(folder: Path, description: dict[str, Any]) -> None:
    try:
        there = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UpslopeError(f"{folder / _DESCRIPTION} can't be read ({error}): start anew in another folder.") from error
    found = differences(there, description)
    if found:
        raise UpslopeError(
            f"{folder} holds another run than the one to be resumed ({'; '.join(found)}): "
            "give the settings it was started with, or another folder with --out."
        )


def differences(there: Any, here: Any, name: str = "") -> list[str]:
    """What differs between two JSON values, one phrase for each place."""
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
