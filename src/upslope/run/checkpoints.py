"""Checkpoints of runs: when they are due, how they are written, which one a resumed run continues from."""

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
from upslope.run.folder import differences, summary
from upslope.run.health import first_not_finite
from upslope.run.position import Position, from_arrays, to_arrays, to_numpy
from upslope.types import Keys

KIND = "upslope-checkpoint"
FORMAT_VERSION = 1

#: Time between saves as a multiple of the time that the last save took.
_LEAST_PAUSE = 60


@dataclass(frozen=True)
class Checkpoints:
    """Where a run's checkpoints go, how often they are saved, and whether the run continues from one.

    Attributes:
        folder: of the run; each title has its own folder under ``checkpoints`` there.
        every_seconds: time between saves; longer if saving takes long, so that it costs less than two per cent.
        every_updates: steps between saves; None uses the clock.
        keep: the number of newest checkpoints that are kept.
        resume: continue from the newest good one. A path selects one file, and is an error if that is damaged.
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
            raise UpslopeError("Checkpoints need keep of 1 or more, and every_seconds and every_updates above 0.")

    def stage(self, title: str, description: dict[str, Any]) -> "Stage":
        """The checkpoints of one run, by its title.

        Raises:
            NotSavedError: their folder can't be made.
        """
        folder = _stage_folder(self.folder, title)
        try:
            # Not when saving: if the folder vanishes later, that must be an error.
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
        return time.monotonic() - self._saved_at >= max(settings.every_seconds, _LEAST_PAUSE * self._cost)

    def save(self, position: Position, *, allow_divergence: bool = False) -> Path:
        """Writes a checkpoint, then drops the oldest beyond those kept.

        Raises:
            NotSavedError: see `storage.write`.
            UpslopeError: a state that is not finite; the checkpoints before it stay.
        """
        began = time.monotonic()
        arrays = to_arrays(position)
        bad = None if allow_divergence else first_not_finite(arrays)
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
        """The position to continue from; None to start from the beginning.

        Args:
            skeleton: makes a `Position` of shapes, with reports and metrics without the axis of marks.
            allow_divergence: accept numbers that are not finite.

        Raises:
            DamagedFileError: the checkpoint at the given path is damaged.
            UpslopeError: a checkpoint of a run with other settings.
        """
        if not self._settings.resume:
            return None
        if isinstance(self._settings.resume, Path):
            return self._read(self._settings.resume, skeleton, allow_divergence)
        for path in self._files():
            try:
                return self._read(path, skeleton, allow_divergence)
            except DamagedFileError as error:
                # Out of the way of a run that starts again, whose first saves would count as older.
                aside = path.with_suffix(".damaged")
                with suppress(OSError):
                    path.replace(aside)
                warnings.warn(f"{error} It is now {aside.name}; trying the one before it.", stacklevel=2)
        return None

    def last_good(self) -> str:
        """A phrase for messages that names the checkpoint to continue from."""
        files = self._files()
        return f"the last good checkpoint is {files[0]}" if files else "there is no checkpoint yet"

    def _files(self) -> list[Path]:
        """Newest first."""
        return sorted(self._folder.glob("*.safetensors"), reverse=True)

    def _read(self, path: Path, skeleton: Callable[[], Position], allow_divergence: bool) -> Position:
        header, arrays, _ = storage.read(path, KIND, FORMAT_VERSION)
        update = header.pop("update", None)
        found = differences(header, self._description)
        if found:
            raise UpslopeError(
                f"{path} is from a run with other settings ({summary(found)}): "
                "resume with the settings that it was started with, or start a new run in another folder."
            )
        bad = None if allow_divergence else first_not_finite(arrays)
        if bad is not None:
            raise DamagedFileError(f"{path} holds numbers that are not finite, in {bad}.")
        needed = skeleton()
        try:
            return from_arrays(int(update), arrays, needed)
        except (KeyError, TypeError, ValueError) as error:
            raise DamagedFileError(f"{path} does not hold what this run needs ({error}).") from error


def adopt(titles: Iterable[str], source: Path, folder: Path) -> None:
    """Copies the checkpoints of some runs, for a run that starts with the same ones and continues from there.

    Args:
        titles: of the runs.
        source: the folder that they ran in.
        folder: of the run that continues from them.

    Raises:
        UpslopeError: one of them has no checkpoint there.
        NotSavedError: they can't be copied.
    """
    for title in titles:
        there, here = _stage_folder(source, title), _stage_folder(folder, title)
        if not any(there.glob("*.safetensors")):
            raise UpslopeError(
                f"{source} holds no training called {title!r}: give the folder of the figure that these priors were "
                "trained for (that of fig2 for fig3, of fig4 for fig5), or leave it out to train them again."
            )
        try:
            shutil.copytree(there, here, dirs_exist_ok=True)
        except OSError as error:
            raise NotSavedError(
                f"{there} can't be copied to {here} ({error}): make room, or give another folder."
            ) from error


def _stage_folder(folder: Path, title: str) -> Path:
    return folder / "checkpoints" / "".join(letter if letter.isalnum() else "_" for letter in title)


def describe(learners: AbstractLearner, keys: Keys, updates: int, every: int) -> dict[str, Any]:
    """What a checkpoint must match: the learners' class, settings and inputs, and how long they run."""
    config = getattr(learners, "config", None)
    inputs = hashlib.sha256()
    for leaf in jax.tree.leaves((learners, keys)):
        inputs.update(np.ascontiguousarray(to_numpy(leaf)).tobytes())
    return {
        "learner": type(learners).__name__,
        "learners": int(np.prod(keys.shape)),
        "updates": updates,
        "every": every,
        "config": _as_json(asdict(config)) if is_dataclass(config) and not isinstance(config, type) else None,
        "inputs": inputs.hexdigest(),
    }


def _as_json(value: Any) -> Any:
    """Tuples as lists, so that it compares with the content of a file."""
    if isinstance(value, dict):
        return {name: _as_json(entry) for name, entry in value.items()}
    return [_as_json(entry) for entry in value] if isinstance(value, list | tuple) else value
