"""What surrounds a run: who watches it, and where it is kept."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upslope.run.ahead import Ahead
from upslope.run.checkpoints import Checkpoints
from upslope.run.observers import EventLog, Observer, ProgressBar


def _ignore(results: Any) -> None:
    del results


@dataclass(frozen=True)
class Session:
    """Observers and checkpoints, the same for all runs of a command.

    Attributes:
        observers: told of the start, of every report and of the end.
        checkpoints: None keeps nothing.
        ahead: where programs are compiled in the background; None for those that compile when they are needed.
        show: is given what an experiment of several runs has come to so far, whenever there is more to be seen.
    """

    observers: Sequence[Observer] = ()
    checkpoints: Checkpoints | None = None
    ahead: Ahead | None = None
    show: Callable[[Any], None] = _ignore


def session_in(folder: Path, *, resume: bool = False, final_states: bool = True) -> Session:
    """What every command does in its folder: a progress bar, logs, checkpoints.

    Args:
        folder: of the run.
        resume: go on from the newest good checkpoints there.
        final_states: keep the learners' states when a run is over; a figure needs their reports only.
    """
    return Session(
        (ProgressBar(), EventLog(folder / "logs")), Checkpoints(folder, resume=resume, final_states=final_states)
    )
