"""Numbers that are not finite, caught at the step where they start, with the likely cause and the mend."""

from collections.abc import Callable
from typing import Any

import numpy as np

from upslope.errors import UpslopeError

#: Words in a metric's name, in the order in which trouble spreads; and the mend.
_MENDS = (
    ("observation", "check what the environment shows there, and the task's parameters."),
    ("reward", "check the rewards of the environment and the potential."),
    ("loss", "lower the step size, or check the size of the rewards and of the potential."),
    ("gradient", "lower the step size."),
    ("", "lower the step size, or check the rewards and the potential."),
)


def check_finite(
    title: str, update: int, broken: np.ndarray, totals: dict[str, Any], known_good: Callable[[], str]
) -> None:
    """Looks at what a chunk of steps left behind.

    Args:
        title: of the run.
        update: steps taken before the chunk.
        broken: of each learner the first step of the chunk with a metric that is not finite; 0 for none.
        totals: sums of the metrics ``[learners, ...]``; a second axis is that of tasks.
        known_good: tells what there is to go back to; asked in trouble only.

    Raises:
        UpslopeError: with phase, learner, task and step.
    """
    if not broken.any():
        return
    learner = int(np.flatnonzero(broken)[0])
    bad = {name: ~np.isfinite(np.asarray(values)[learner]) for name, values in totals.items()}
    name = min((name for name, places in bad.items() if places.any()), key=_phase)
    task = f", task {int(np.flatnonzero(bad[name])[0])}" if bad[name].ndim else ""
    raise UpslopeError(
        f"{title}: {name} of learner {learner}{task} is not a finite number at update {update + broken[learner]} "
        f"({np.count_nonzero(broken)} of {broken.size} learners in trouble): {_MENDS[_phase(name)][1]}{known_good()}"
    )


def _phase(name: str) -> int:
    return next(index for index, (word, _) in enumerate(_MENDS) if word in name)
