"""Φ' of many environments at once, by the terms in force: what the wrappers of vector environments share."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.terms import Terms


class Levels:
    """w·(bias + scale·Φ) of ``n`` environments. Φ is asked only where it counts: elsewhere it need not be defined.

    Attributes:
        steps: taken by every environment so far; they decide the weight.
        active: whether each environment's present episode is shaped ``[n]``.
    """

    def __init__(self, evaluator: Evaluator, terms: Terms, active: Bool[np.ndarray, "n"]):
        self._evaluator, self._terms = evaluator, terms
        self.steps = 0
        self.active = active

    def of(self, obs: Any, asked: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """The levels of a batch of observations, zero where they are not asked for or the episode is not shaped."""
        weight, counted = self._counted(asked)
        return self._levels(weight, self._evaluator.where(obs, counted), counted)

    def of_last(self, observations: Any, asked: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """The same for the last observations of episodes, which come one by one; there are none of the others."""
        weight, counted = self._counted(asked)
        values = np.zeros(len(asked))
        values[counted] = self._evaluator.several([observations[i] for i in np.flatnonzero(counted)])
        return self._levels(weight, values, counted)

    def _counted(self, asked: Bool[np.ndarray, "n"]) -> tuple[float, Bool[np.ndarray, "n"]]:
        """The weight in force, and where anything counts."""
        weight = self._terms.weight(self.steps)
        return weight, asked & self.active if weight else np.zeros_like(asked)

    def _levels(
        self, weight: float, values: Float[np.ndarray, "n"], counted: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        return weight * counted * (self._terms.bias + self._terms.scale * values)
