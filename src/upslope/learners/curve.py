"""Learning curves."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False, repr=False)
class LearningCurve:
    """A learner's performance at each of its reports. The first report is before any update.

    Attributes:
        updates: the number of updates before each report; for Algorithm 1, of iterations.
        returns: the raw, undiscounted return of the greedy policy.
        metrics: the mean of each of the learner's metrics since the previous report, by name.
    """

    updates: Int[np.ndarray, "reports"]
    returns: Float[np.ndarray, "reports"]
    metrics: dict[str, Float[np.ndarray, "reports ..."]]

    def summary(self) -> str:
        """The first, last and best return, and the number of updates."""
        first, last, best = self.returns[0], self.returns[-1], np.max(self.returns)
        return f"return {first:.4g} → {last:.4g} in {self.updates[-1]} updates (best {best:.4g})"

    def __repr__(self) -> str:
        return f"LearningCurve({self.summary()})"
