"""What surrounds a run: its observers, its checkpoints, its compiler in the background."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from upslope.run.checkpoints import Checkpoints
from upslope.run.compiling import Ahead
from upslope.run.observers import EventLog, Observer, ProgressBar, has_display


def _ignore(results: Any) -> None:
    del results


@dataclass(frozen=True)
class Session:
    """Observers and checkpoints, the same for all runs of a command.

    Attributes:
        observers: notified of the start, every report and the end.
        checkpoints: where they go; None saves none.
        ahead: compiles programs in the background; None compiles each when it is needed.
        show: called with the results of an experiment of several runs whenever there are new ones.
    """

    observers: Sequence[Observer] = ()
    checkpoints: Checkpoints | None = None
    ahead: Ahead | None = None
    show: Callable[[Any], None] = _ignore


def session_in(folder: Path, *, resume: bool = False, final_states: bool = True) -> Session:
    """The session of a command: a progress bar, and logs and checkpoints in a folder.

    Args:
        folder: of the run.
        resume: continue from the newest good checkpoints there.
        final_states: keep the learners' states when a run is over; a figure only needs their reports.
    """
    return Session(
        (ProgressBar(), EventLog(folder / "logs")), Checkpoints(folder, resume=resume, final_states=final_states)
    )


def with_progress(session: Session | None, progress: bool | None) -> Session:
    """The session with a progress bar where one is wanted.

    Args:
        session: None for one without observers and checkpoints.
        progress: True and False decide; None shows a bar in a terminal or a notebook, unless there are observers.
    """
    session = session or Session()
    wanted = has_display() and not session.observers if progress is None else progress
    return replace(session, observers=(*session.observers, ProgressBar())) if wanted else session
