"""Φ' of many environments at once, by the terms in force: what the wrappers of vector environments share."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.terms import Terms


class Levels:
    """Bias + scale·Φ of ``n`` environments, and the weight that each counts with.

    Attributes:
        steps: taken by every environment so far; they decide the weight.
        active: whether each environment's present episode is shaped ``[n]``.
    """

    def __init__(self, evaluator: Evaluator, terms: Terms, active: Bool[np.ndarray, "n"]):
        self._evaluator, self._terms = evaluator, terms
        self.steps = 0
        self.active = active

    def of(self, obs: Any, *, enabled: bool) -> Float[np.ndarray, "n"]:
        """Bias + scale·Φ of a batch of observations; zeros where nothing is shaped, now or after the next reset."""
        if not (self.active.any() or enabled) or not self._terms.weight(self.steps):
            return np.zeros(len(self.active))
        return self._terms.bias + self._terms.scale * self._evaluator.many(obs, len(self.active))

    @property
    def weights(self) -> Float[np.ndarray, "n"]:
        """w(t) where the episode is shaped, else zero."""
        return self.active * self._terms.weight(self.steps)
