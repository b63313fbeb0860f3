"""How well a learner did on its way."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False, repr=False)
class LearningCurve:
    """How well a learner did at each of its reports, the first of them before any update.

    Attributes:
        updates: steps taken; of Algorithm 1, iterations.
        returns: of the greedy policy, raw and undiscounted.
        metrics: means of the learner's own measurements since the report before, by name.
    """

    updates: Int[np.ndarray, "reports"]
    returns: Float[np.ndarray, "reports"]
    metrics: dict[str, Float[np.ndarray, "reports ..."]]

    def summary(self) -> str:
        """The first and the last return, the best one, and how many updates there were."""
        first, last, best = self.returns[0], self.returns[-1], np.max(self.returns)
        return f"return {first:.4g} → {last:.4g} in {self.updates[-1]} updates (best {best:.4g})"

    def __repr__(self) -> str:
        return f"LearningCurve({self.summary()})"
