"""What a layer of wrappers returned, call by call, and the transitions of each environment that follow from it."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class LayerTransition(NamedTuple):
    """One transition of one environment, as a layer shows it.

    Attributes:
        obs: s.
        successor: s', the true one; None where the layer hides it.
        shown: what the layer returned; differs from s' only where it resets in the same step.
        reward: that the layer returned.
        below: the reward that the layer was given.
        terminated: whether the episode terminated.
        truncated: whether it was truncated.
        dummy: a step that only resets, under next-step autoreset; not a transition.
        first: whether it is the first of its episode.
        last_before: the last observation of the episode before, if any.
        step: when, in steps of the layer.
        age: when, in transitions of this environment: steps that only reset are not counted.
    """

    obs: Any
    successor: Any
    shown: Any
    reward: float
    below: float
    terminated: bool
    truncated: bool
    dummy: bool
    first: bool
    last_before: Any
    step: int
    age: int


class Autoresets(NamedTuple):
    """When the environments of a layer reset without being asked.

    Attributes:
        same_step: in the step that ends the episode; the last observation is then reported apart.
        next_step: in the step after it, unless ``reset`` is called first.
    """

    same_step: bool
    next_step: bool


class ResetCall(NamedTuple):
    """A reset.

    Attributes:
        observations: of each environment ``[n]``.
        begins: whether an episode begins ``[n]``.
    """

    observations: Sequence[Any]
    begins: Bool[np.ndarray, "n"]

    @property
    def rewards(self) -> Float[np.ndarray, "n"]:
        return np.zeros(len(self.begins))

    def replay(self, episodes: "Episodes", index: int) -> Iterator[LayerTransition]:
        """Follows one environment; a reset is not a transition."""
        if self.begins[index]:
            episodes.reset(self.observations[index])
        yield from ()


class StepCall(NamedTuple):
    """A step.

    Attributes:
        observations: of each environment ``[n]``.
        rewards: that the layer returned ``[n]``.
        given: the rewards that the layer was given; NaN where they are hidden ``[n]``.
        terminated: whether each episode terminated ``[n]``.
        truncated: whether it was truncated ``[n]``.
        finals: the last observations of episodes that were reset in the same step; None elsewhere ``[n]``.
    """

    observations: Sequence[Any]
    rewards: Float[np.ndarray, "n"]
    given: Float[np.ndarray, "n"]
    terminated: Bool[np.ndarray, "n"]
    truncated: Bool[np.ndarray, "n"]
    finals: Any

    def replay(self, episodes: "Episodes", index: int) -> Iterator[LayerTransition]:
        """The transition of one environment."""
        numbers = float(self.rewards[index]), float(self.given[index])
        ends = bool(self.terminated[index]), bool(self.truncated[index])
        yield episodes.step(self.observations[index], *numbers, *ends, self.finals[index])


class Episodes:
    """Follows the episodes of one environment through the calls of a layer."""

    def __init__(self, autoresets: Autoresets):
        self._autoresets = autoresets
        self._obs = self._last_before = None
        self._is_first, self._resets = True, False
        self._step = self._age = 0

    def reset(self, obs: Any) -> None:
        if not self._is_first:
            self._last_before = self._obs
        self._obs, self._is_first, self._resets = obs, True, False

    def step(
        self, shown: Any, reward: float, given: float, terminated: bool, truncated: bool, final: Any
    ) -> LayerTransition:
        self._step += 1
        self._age += not self._resets
        done = terminated or truncated
        has_reset = done and self._autoresets.same_step
        successor = final if has_reset else shown
        if self._resets and np.isnan(given):  # a reset has no raw reward to report
            given = reward
        transition = LayerTransition(
            self._obs, successor, shown, reward, given, terminated, truncated, self._resets, self._is_first,
            self._last_before, self._step, self._age,
        )  # fmt: skip
        if self._resets:
            self._last_before = self._obs
        if has_reset:
            self._last_before = successor
        self._is_first = self._resets or has_reset
        self._resets = done and self._autoresets.next_step
        self._obs = shown
        return transition
