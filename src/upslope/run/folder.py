"""Folders of runs: claimed before anything is written, never overwritten."""

from datetime import datetime
from pathlib import Path

from upslope.errors import UpslopeError


def claim(folder: Path | None, kind: str) -> Path:
    """Makes an empty folder for a run.

    Args:
        folder: where to; ``runs/<kind>-<date>-<time>`` if None.
        kind: what kind of run it is.

    Raises:
        UpslopeError: the folder holds something already, or can't be made.
    """
    chosen = folder or Path("runs") / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    try:
        if chosen.exists() and (not chosen.is_dir() or any(chosen.iterdir())):
            raise UpslopeError(
                f"{chosen} already holds something, and nothing is overwritten: "
                "give another folder with --out, or move that one away."
            )
        chosen.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UpslopeError(
            f"{chosen} can't be used as a folder ({error.strerror}): give another with --out."
        ) from error
    return chosen
