"""F for environments that run together: what the wrappers of vector environments share, whatever the library."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from upslope.equations.shaping import shaping_reward
from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.terms import Terms


class BatchShaping:
    """Keeps Φ' = w·(bias + scale·Φ) of ``n`` environments from step to step, and computes F.

    Φ is evaluated only where it counts: at terminal states and in episodes that are not shaped it need not be defined.
    """

    def __init__(self, evaluator: Evaluator, terms: Terms, active: Bool[np.ndarray, "n"]):
        """Takes Φ, the settings, and in which environments the first episodes are shaped."""
        self._evaluator, self._terms = evaluator, terms
        self._active = active
        self._steps = 0  # taken by every environment so far: they determine the weight
        self._potentials: Float[np.ndarray, n] | None = None

    def check_begun(self) -> None:
        """Checks that the environments have been reset.

        Raises:
            UpslopeError: they have not.
        """
        if self._potentials is None:
            raise UpslopeError("step was called before reset: reset the environments first.")

    def reset(self, obs: Any, begins: Bool[np.ndarray, "n"], enabled: bool) -> Float[np.ndarray, "n"]:
        """Episodes begin, in some of the environments or in all; returns Φ' of every environment's observation."""
        self._begin(begins, enabled)
        previous = np.zeros(len(begins)) if self._potentials is None else self._potentials
        self._potentials = np.where(begins, self._levels(obs, begins), previous)
        return self._potentials

    def step(
        self, obs: Any, terminated: Bool[np.ndarray, "n"], begins: Bool[np.ndarray, "n"], enabled: bool
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """One step where every observation is the true successor, except that some environments begin an episode.

        Returns:
            F, zero where an episode begins, and Φ'(s').
        """
        self._steps += 1
        self._begin(begins, enabled)
        successors = self._levels(obs, ~terminated)
        return np.where(begins, 0.0, self._advance(successors, successors)), successors

    def step_with_resets(
        self,
        obs: Any,
        done: Bool[np.ndarray, "n"],
        terminated: Bool[np.ndarray, "n"],
        final_observations: Any,
        enabled: bool,
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """One step after which the environments whose episode is done show the first observation of the next one.

        Args:
            obs: what the environments show.
            done: whether the episode is over.
            terminated: whether it terminated.
            final_observations: the last observation of each episode that is done; None elsewhere.
            enabled: whether to shape the episodes that begin.

        Returns:
            F and Φ'(s'), with s' the true successor.

        Raises:
            UpslopeError: a final observation is missing.
        """
        self._steps += 1
        if not done.any():
            successors = shown = self._levels(obs, ~done)
        else:
            if any(final_observations[i] is None for i in np.flatnonzero(done & self._active)):
                raise UpslopeError(
                    "The vector environment resets in the same step but hides the final observation: it must give it "
                    'in infos["final_obs"] (Gymnasium) or infos[i]["terminal_observation"] (Stable-Baselines3), or '
                    "use AutoresetMode.NEXT_STEP."
                )
            last = self._final_levels(final_observations, done & ~terminated)
            self._begin(done, enabled)
            shown = self._levels(obs, np.ones_like(done))
            successors = np.where(done, last, shown)
        return self._advance(successors, shown), successors

    def _begin(self, begins: Bool[np.ndarray, "n"], enabled: bool) -> None:
        """The switch takes effect where an episode begins."""
        self._active = np.where(begins, enabled, self._active)

    def _advance(self, successors: Float[np.ndarray, "n"], shown: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """F from the remembered Φ'(s), which then becomes that of what is shown."""
        added = shaping_reward(self._potentials, self._terms.gamma, successors)
        self._potentials = shown
        return added

    def _levels(self, obs: Any, needed: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Φ' of a batch of observations, zero where it is not needed or the episode is not shaped."""
        weight, counts = self._counts(needed)
        return counts * self._terms.level(self._evaluator.where(obs, counts), weight)

    def _final_levels(self, observations: Any, needed: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """The same for the last observations of episodes, which come one by one."""
        weight, counts = self._counts(needed)
        values = np.zeros(len(needed))
        values[counts] = self._evaluator.several([observations[i] for i in np.flatnonzero(counts)])
        return counts * self._terms.level(values, weight)

    def _counts(self, needed: Bool[np.ndarray, "n"]) -> tuple[float, Bool[np.ndarray, "n"]]:
        """The present weight, and where Φ' is not zero."""
        weight = self._terms.weight(self._steps)
        return weight, needed & self._active if weight else np.zeros_like(needed)
