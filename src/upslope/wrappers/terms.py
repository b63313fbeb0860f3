"""The terms of a shaping: γ, scale, bias, and how its weight changes over time. The same for every kind of wrapper."""

import math
from typing import Any

from upslope.errors import UpslopeError


class Terms:
    """Φ' = w(t)·(bias + scale·Φ), and F = d·Φ'(s') − Φ'(s) with d = γ·(1 − terminated).

    Attributes:
        gamma: γ.
        scale: of Φ.
        bias: added to Φ, in units of return. Both move Q's initial values, and so how a deep learner explores.
        anneal_steps: w falls linearly from 1 to 0 over so many steps; None keeps it at 1.
    """

    def __init__(self, potential: Any, gamma: float, scale: float, bias: float, anneal_steps: int | None):
        """Takes the settings, and Φ for the γ that it was learned with.

        Raises:
            UpslopeError: no discount, another γ than the prior's, or settings that are no numbers.
        """
        if not (isinstance(gamma, int | float) and 0 < gamma <= 1):
            raise UpslopeError(
                f"gamma is {gamma!r}, but a discount lies in (0, 1]: give the one that the learner uses."
            )
        learned_with = getattr(potential, "gamma", None)
        if learned_with is not None and learned_with != gamma:
            raise UpslopeError(
                f"gamma is {gamma}, but the prior was learned with {learned_with}: give gamma={learned_with} to the "
                "shaping and to the learner, or meta-train a prior with the learner's gamma."
            )
        for name, value in (("scale", scale), ("bias", bias)):
            if not (isinstance(value, int | float) and math.isfinite(value)):
                raise UpslopeError(f"{name} is {value!r}, but it must be a finite number: give one such as 1.0.")
        if anneal_steps is not None and not (isinstance(anneal_steps, int) and anneal_steps >= 1):
            raise UpslopeError(
                f"anneal_steps is {anneal_steps!r}: give a whole number of steps, or None for no annealing."
            )
        self.gamma, self.scale, self.bias, self.anneal_steps = float(gamma), float(scale), float(bias), anneal_steps

    def weight(self, step: int) -> float:
        """w(t) after ``step`` steps."""
        return 1.0 if self.anneal_steps is None else max(0.0, 1.0 - step / self.anneal_steps)

    @property
    def invariance(self) -> str:
        """What these terms keep of policy invariance, in a sentence."""
        if self.anneal_steps is None:
            return "kept: the optimal policies of the shaped task are those of the raw one (Thm. 2.1)."
        return (
            "kept for learners without a replay: F = d·w(t+1)Φ(s') − w(t)Φ(s) telescopes over every episode. "
            "A replay mixes F of many weights, and that is not policy-invariant: anneal over less than the replay "
            "holds, or shape where batches are drawn."
        )
