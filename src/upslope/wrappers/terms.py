"""The settings of a shaping: γ, scale, bias, and how its weight changes over time. All wrappers share them."""

import math
from numbers import Integral, Real
from typing import Any

import numpy as np

from upslope.errors import UpslopeError

#: Numbers of Python and of NumPy.
Number = float | int | np.floating | np.integer
Count = int | np.integer

# Discounts this close are equal: float32 keeps about seven digits.
_SAME = 1e-6


class Terms:
    """Checked settings: Φ' = w(t)·(bias + scale·Φ), and F = d·Φ'(s') − Φ'(s) with d = γ·(1 − terminated).

    Attributes:
        gamma: γ of one step.
        scale: factor of Φ.
        bias: added to the scaled Φ, in units of return.
        anneal_steps: number of steps over which w falls linearly from 1 to 0; None keeps it at 1.
        repeat: number of times that a step repeats its action.
    """

    def __init__(
        self,
        potential: Any,
        gamma: Number | Any,
        scale: Number | Any = 1.0,
        bias: Number | Any = 0.0,
        anneal_steps: Count | Any = None,
        repeat: Count | Any = 1,
    ):
        """Takes the settings, and Φ, which may know the γ that it was learned with.

        Raises:
            UpslopeError: γ is not a discount or not the prior's, or another setting is not a number of its kind.
        """
        if not (_is_finite(gamma) and 0 < gamma <= 1):
            raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give the learner's.")
        for name, value in (("scale", scale), ("bias", bias)):
            if not _is_finite(value):
                raise UpslopeError(f"{name} is {value!r}, but it must be a finite number: give one such as 1.0.")
        if anneal_steps is not None and not _is_count(anneal_steps):
            raise UpslopeError(
                f"anneal_steps is {anneal_steps!r}: give a whole number of steps, or None for no annealing."
            )
        if not _is_count(repeat):
            raise UpslopeError(f"repeat is {repeat!r}: give the number of actions in a step, 1 if a step repeats none.")
        self.gamma, self.scale, self.bias = float(gamma), float(scale), float(bias)
        self.anneal_steps = None if anneal_steps is None else int(anneal_steps)
        self.repeat = int(repeat)
        _check_gamma(getattr(potential, "gamma", None), self.gamma, self.repeat)

    @property
    def settings(self) -> dict[str, Any]:
        """All of them by name, as plain numbers: for the spec of a wrapped environment."""
        return dict(vars(self))

    def level(self, value: Any, weight: float) -> Any:
        """Φ' of Φ(s), one number or an array of them, with the weight of the present step."""
        return weight * (self.bias + self.scale * value)

    def weight(self, step: int) -> float:
        """The weight w after ``step`` steps."""
        return 1.0 if self.anneal_steps is None else max(0.0, 1.0 - step / self.anneal_steps)

    @property
    def invariance(self) -> str:
        """Whether these settings keep the optimal policies, in a sentence."""
        if self.anneal_steps is None:
            return "kept: the optimal policies of the shaped task are those of the raw one (Thm. 2.1)."
        return (
            "kept for learners without a replay: F = d·w(t+1)Φ(s') − w(t)Φ(s) telescopes over every episode. "
            "A replay mixes F of many weights, which is not policy-invariant: anneal over fewer steps than the replay "
            "holds, or shape where batches are drawn."
        )


def _check_gamma(learned_with: Any, gamma: float, repeat: int) -> None:
    """Checks that γ of one step is the prior's to the power of the number of actions in a step."""
    if not _is_finite(learned_with) or math.isclose(gamma, learned_with**repeat, abs_tol=_SAME):
        return
    needed = f"{learned_with**repeat:.8g}"
    power = f", which is {needed} for {repeat} repeated actions" if repeat > 1 else ""
    raise UpslopeError(
        f"gamma is {gamma:.8g}, but the prior was learned with {learned_with}{power}: give gamma={needed} to the "
        "shaping and to the learner, set repeat to the number of times that a step repeats its action (gamma is then "
        "the prior's to that power), or meta-train a prior with the learner's gamma."
    )


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _is_count(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1
