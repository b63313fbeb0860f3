"""Recorded transitions as numbers: what was added to each reward, and Φ of the observations that may explain it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from upslope.checking.calls import LayerTransition
from upslope.equations.shaping import shaping_reward
from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.observations import misfit


class Evidence(NamedTuple):
    """Transitions ``[n]`` of one layer, as numbers.

    Attributes:
        added: what the layer added to the reward.
        below: the reward that the layer was given.
        phi: Φ(s).
        successor: Φ(s') at the true successor.
        shown: Φ of the observation that was returned, possibly the first of the next episode.
        last_before: Φ of the last observation of the episode before; NaN for none.
        terminated: this and the other flags and times are those of `upslope.checking.calls.LayerTransition`.
    """

    added: Float[np.ndarray, "n"]
    below: Float[np.ndarray, "n"]
    phi: Float[np.ndarray, "n"]
    successor: Float[np.ndarray, "n"]
    shown: Float[np.ndarray, "n"]
    last_before: Float[np.ndarray, "n"]
    terminated: Bool[np.ndarray, "n"]
    truncated: Bool[np.ndarray, "n"]
    dummy: Bool[np.ndarray, "n"]
    first: Bool[np.ndarray, "n"]
    step: Any
    age: Any

    def take(self, where: Any) -> "Evidence":
        return Evidence(*(leaf[where] for leaf in self))

    def expected(self, gamma: float) -> Float[np.ndarray, "n"]:
        """F by Def. 2.1."""
        return shaping_reward(self.phi, gamma, np.where(self.terminated, 0.0, self.successor))


class UnusableError(UpslopeError):
    """Φ can't be computed for an observation.

    Attributes:
        name: of the finding.
        step: at which this happened.
    """

    def __init__(self, name: str, step: int, words: str):
        super().__init__(words)
        self.name, self.step = name, step


def gather(seen: Sequence[LayerTransition], evaluator: Evaluator, space: Any) -> Evidence:
    """The evidence in recorded transitions.

    Raises:
        UnusableError: an observation has a wrong shape, or Φ fails where it counts.
    """
    rows = []
    for one in seen:
        # Φ need not be defined at terminal states, where it counts as zero.
        successor = (
            _phi_or_nan(evaluator, one.successor)
            if one.terminated
            else phi_of(evaluator, space, one.successor, one.step)
        )
        shown = successor if one.shown is one.successor else phi_of(evaluator, space, one.shown, one.step)
        before = np.nan if one.last_before is None else _phi_or_nan(evaluator, one.last_before)
        phi = phi_of(evaluator, space, one.obs, one.step)
        rows.append((one.reward - one.below, one.below, phi, successor, shown, before))
    numbers = np.array(rows, np.float64).reshape(len(seen), 6).T
    flags = np.array(
        [(one.terminated, one.truncated, one.dummy, one.first) for one in seen], bool
    ).reshape(len(seen), 4).T  # fmt: skip
    times = np.array([(one.step, one.age) for one in seen], int).reshape(len(seen), 2).T
    return Evidence(*numbers, *flags, *times)


def phi_of(evaluator: Evaluator, space: Any, obs: Any, step: int) -> float:
    """Φ of one observation.

    Raises:
        UnusableError: the observation has a wrong shape, or Φ fails.
    """
    words = misfit(space, obs)
    if words:
        raise UnusableError("wrong_observation_shape", step, words)
    try:
        return evaluator.one(obs)
    except UpslopeError as error:
        raise UnusableError("bad_potential", step, str(error)) from error


def _phi_or_nan(evaluator: Evaluator, obs: Any) -> float:
    try:
        return evaluator.one(obs)
    except UpslopeError:
        return float("nan")
