"""Checkpoints of runs: when they are due, how they are written, which one a resumed run goes on from."""

import hashlib
import shutil
import time
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from upslope import storage
from upslope.errors import DamagedFileError, NotSavedError, UpslopeError
from upslope.learners.learner import AbstractLearner
from upslope.run.folder import differences
from upslope.run.position import Position, from_arrays, on_host, to_arrays
from upslope.types import Keys

KIND = "upslope-checkpoint"
FORMAT_VERSION = 1

#: Of a run's time at most one part in so many goes into saving, however large the state is.
_DEAREST = 60


@dataclass(frozen=True)
class Checkpoints:
    """Where a run's checkpoints go, how often, and whether it goes on from one.

    Attributes:
        folder: of the run; each title has a folder of its own under ``checkpoints`` there.
        every_seconds: between saves; more where saving takes long, so that it costs less than two per cent.
        every_updates: between saves, counted in steps; None leaves it to the clock.
        keep: how many of the newest are kept.
        resume: go on from the newest good one. A path means that very file, and fails if it is not good.
        final_states: keep the learners' states when a run is over, not only its reports.
    """

    folder: Path
    every_seconds: float = 60.0
    every_updates: int | None = None
    keep: int = 2
    resume: bool | Path = False
    final_states: bool = True

    def __post_init__(self) -> None:
        if self.keep < 1 or not self.every_seconds > 0 or (self.every_updates is not None and self.every_updates < 1):
            raise UpslopeError("Checkpoints need at least 1 kept, and more than 0 seconds and updates between two.")

    def stage(self, title: str, description: dict[str, Any]) -> "Stage":
        """The checkpoints of one run, by its title.

        Raises:
            NotSavedError: there can be no folder for them.
        """
        folder = _of_stage(self.folder, title)
        try:
            # Now and not when saving: a folder that vanishes later shall be missed, not made anew.
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise NotSavedError(f"{folder} can't be made ({error.strerror}): give another folder.") from error
        return Stage(self, folder, {"title": title, **description})


class Stage:
    """The checkpoints of one run."""

    def __init__(self, settings: Checkpoints, folder: Path, description: dict[str, Any]):
        self._settings = settings
        self._folder = folder
        self._description = description
        self._saved_at = time.monotonic()
        self._saved_update = 0
        self._cost = 0.0

    def due(self, update: int) -> bool:
        """Whether it is time to save."""
        settings = self._settings
        if settings.every_updates is not None:
            return update - self._saved_update >= settings.every_updates
        return time.monotonic() - self._saved_at >= max(settings.every_seconds, _DEAREST * self._cost)

    def save(self, position: Position, *, allow_divergence: bool = False) -> Path:
        """Writes a checkpoint, then drops the oldest beyond those kept.

        Raises:
            NotSavedError: see `storage.write`.
            UpslopeError: a state that is not finite; the checkpoints before it stay.
        """
        began = time.monotonic()
        arrays = to_arrays(position)
        bad = None if allow_divergence else _not_finite(arrays)
        if bad is not None:
            raise UpslopeError(
                f"{self._description['title']}: {bad} is not finite at update {position.update}, so this state is not "
                f"saved; {self.last_good()}. Lower the step size, or check the rewards and the potential."
            )
        path = self._folder / f"{position.update:012d}.safetensors"
        storage.write(path, KIND, FORMAT_VERSION, {**self._description, "update": position.update}, arrays)
        for old in self._files()[self._settings.keep :]:
            old.unlink(missing_ok=True)
        for leftover in self._folder.glob("*.tmp"):
            leftover.unlink(missing_ok=True)
        self._saved_at, self._saved_update = time.monotonic(), position.update
        self._cost = self._saved_at - began
        return path

    def finish(self, position: Position, *, allow_divergence: bool = False) -> None:
        """The last save of a run that is over."""
        kept = position if self._settings.final_states else position._replace(states=None, totals=None)
        path = self.save(kept, allow_divergence=allow_divergence)
        if not self._settings.final_states:
            for other in self._files():
                if other != path:
                    other.unlink(missing_ok=True)

    def load(self, skeleton: Callable[[], Position], *, allow_divergence: bool = False) -> Position | None:
        """Where to go on from; None to start anew.

        Args:
            skeleton: makes a `Position` of shapes, its reports and metrics without the axis of marks.
            allow_divergence: numbers that are not finite are none of its business.

        Raises:
            DamagedFileError: a checkpoint asked for by its path is not good.
            UpslopeError: a checkpoint of other settings.
        """
        if not self._settings.resume:
            return None
        if isinstance(self._settings.resume, Path):
            return self._read(self._settings.resume, skeleton, allow_divergence)
        for path in self._files():
            try:
                return self._read(path, skeleton, allow_divergence)
            except DamagedFileError as error:
                # Out of the way of a run that begins anew, whose first saves count as older.
                aside = path.with_suffix(".damaged")
                with suppress(OSError):
                    path.replace(aside)
                warnings.warn(f"{error} It is {aside.name} now; trying the one before it.", stacklevel=2)
        return None

    def last_good(self) -> str:
        """What to tell people who want to go on."""
        files = self._files()
        return f"the last good checkpoint is {files[0]}" if files else "there is no checkpoint of it yet"

    def _files(self) -> list[Path]:
        """Newest first."""
        return sorted(self._folder.glob("*.safetensors"), reverse=True)

    def _read(self, path: Path, skeleton: Callable[[], Position], allow_divergence: bool) -> Position:
        header, arrays, _ = storage.read(path, KIND, FORMAT_VERSION)
        update = header.pop("update", None)
        found = differences(header, self._description)
        if found:
            raise UpslopeError(
                f"{path} is of a run with other settings ({'; '.join(found)}): "
                "resume with the settings that it was started with, or start anew in another folder."
            )
        bad = None if allow_divergence else _not_finite(arrays)
        if bad is not None:
            raise DamagedFileError(f"{path} holds numbers that are not finite, in {bad}.")
        needed = skeleton()
        try:
            return from_arrays(int(update), arrays, needed)
        except (KeyError, TypeError, ValueError) as error:
            raise DamagedFileError(f"{path} does not hold what this run needs ({error}).") from error


def adopt(titles: Iterable[str], source: Path, folder: Path) -> None:
    """Copies what is kept of some runs, to be gone on from by a run that begins with the same ones.

    Args:
        titles: of the runs.
        source: the folder they ran in.
        folder: of the run that goes on from them.

    Raises:
        UpslopeError: one of them has left nothing there.
        NotSavedError: they can't be copied.
    """
    for title in titles:
        there, here = _of_stage(source, title), _of_stage(folder, title)
        if not any(there.glob("*.safetensors")):
            raise UpslopeError(
                f"{source} holds no training called {title!r}: give the folder of the figure that these priors were "
                "trained for (that of fig2 for fig3, of fig4 for fig5), or leave it out to train them anew."
            )
        try:
            shutil.copytree(there, here, dirs_exist_ok=True)
        except OSError as error:
            raise NotSavedError(
                f"{there} can't be copied to {here} ({error}): make room, or give another folder."
            ) from error


def _of_stage(folder: Path, title: str) -> Path:
    return folder / "checkpoints" / "".join(letter if letter.isalnum() else "_" for letter in title)


def describe(learners: AbstractLearner, keys: Keys, updates: int, every: int) -> dict[str, Any]:
    """What a checkpoint must agree with: the learners' kind, settings and inputs, and how long they run."""
    config = getattr(learners, "config", None)
    inputs = hashlib.sha256()
    for leaf in jax.tree.leaves((learners, keys)):
        inputs.update(np.ascontiguousarray(on_host(leaf)).tobytes())
    return {
        "learner": type(learners).__name__,
        "learners": int(np.prod(keys.shape)),
        "updates": updates,
        "every": every,
        "config": _as_json(asdict(config)) if is_dataclass(config) and not isinstance(config, type) else None,
        "inputs": inputs.hexdigest(),
    }


def _as_json(value: Any) -> Any:
    """Tuples as lists, so that it compares with what comes back from a file."""
    if isinstance(value, dict):
        return {name: _as_json(entry) for name, entry in value.items()}
    return [_as_json(entry) for entry in value] if isinstance(value, list | tuple) else value


def _not_finite(arrays: dict[str, np.ndarray]) -> str | None:
    """The name of the first array with such numbers."""
    floats = ((name, array) for name, array in arrays.items() if np.issubdtype(array.dtype, np.floating))
    return next((name for name, array in floats if not np.isfinite(array).all()), None)
