"""What everything that learns has in common: a pair of pure functions over immutable PyTrees."""

from abc import abstractmethod
from typing import Any

import equinox as eqx

from upslope.types import Key, Metrics


class AbstractLearner(eqx.Module):
    """Algorithm 1, Algorithm 2, MAML, DQN, DDPG: each is one of these, and one loop runs them all.

    A learner is a PyTree: tasks, potentials and step sizes are its array leaves, so that learners stack along a batch
    axis and share one compiled program. Everything that changes while learning is in the state.
    """

    @abstractmethod
    def init(self, key: Key) -> Any:
        """The state before the first step."""

    @abstractmethod
    def step(self, state: Any) -> tuple[Any, Metrics]:
        """One update, as the figures count them."""

    @abstractmethod
    def report(self, state: Any) -> dict[str, Any]:
        """What is recorded between chunks of steps: at least ``return``, the raw greedy return. Changes no state."""
