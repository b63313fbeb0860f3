"""A disk that fills up at each write of a save: the earlier save is always intact."""

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np

from reliability.processes import require
from upslope import storage
from upslope.errors import NotSavedError


def full(folder: Path, megabytes: int) -> dict[str, Any]:
    """Makes the n-th step of a save fail with no space left, for every n until the save succeeds."""
    path = folder / "state.safetensors"
    old = {"a": np.zeros(megabytes * 2**18, np.float32)}
    new = {"a": np.ones(megabytes * 2**18, np.float32)}
    before, failures = storage.milestone, 0
    try:
        while True:
            storage.write(path, "test", 1, {}, old)
            left = failures

            def milestone(name: str) -> None:
                nonlocal left
                if left == 0 and not name.endswith("the folder's fsync"):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                left -= 1

            storage.milestone = milestone
            try:
                storage.write(path, "test", 1, {}, new)
            except NotSavedError:
                failures += 1
            else:
                break
            finally:
                storage.milestone = before
            kept = storage.read(path, "test", 1).arrays["a"]
            require(bool((kept == 0).all()), f"failure {failures} of a save touched the file before")
            require([entry.name for entry in folder.iterdir()] == [path.name], "a failed save left litter")
    finally:
        storage.milestone = before
    return {"writes_that_failed": failures, "intact_before": failures}
