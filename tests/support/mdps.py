"""Random finite MDPs in numpy with exact value iteration, to check the theorems."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class FiniteMDP:
    """A finite MDP; entering a terminal state ends the episode.

    Attributes:
        chances: P(s' | s, a) ``[states, actions, states]``.
        rewards: R(s, a, s') ``[states, actions, states]``.
        terminal: which states end the episode ``[states]``.
    """

    chances: np.ndarray
    rewards: np.ndarray
    terminal: np.ndarray
    gamma: float

    @property
    def discount(self) -> np.ndarray:
        """d(s') = γ·(1 − terminal(s')) ``[states]``."""
        return self.gamma * (1.0 - self.terminal)

    @property
    def ordinary(self) -> np.ndarray:
        """Indices of the non-terminal states."""
        return np.flatnonzero(~self.terminal)


class Optimum(NamedTuple):
    """V* ``[states]`` (zero at terminal states), Q* ``[states, actions]``."""

    v: np.ndarray
    q: np.ndarray


def random_mdp(seed: int, *, states: int = 8, actions: int = 3, gamma: float = 0.95) -> FiniteMDP:
    """Sparse transitions, normal rewards, two terminal states; in some states the last action repeats the first."""
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(states), size=(states, actions)) * (rng.random((states, actions, states)) < 0.5)
    chances += 1e-9 * rng.random(chances.shape)
    chances /= chances.sum(-1, keepdims=True)
    rewards = rng.normal(size=chances.shape)
    twins = rng.random(states) < 0.3  # two equally good actions: greedy *sets* are compared
    chances[twins, -1], rewards[twins, -1] = chances[twins, 0], rewards[twins, 0]
    return FiniteMDP(chances, rewards, np.arange(states) >= states - 2, gamma)


def solve(mdp: FiniteMDP, added: np.ndarray | float = 0.0, *, tolerance: float = 1e-13) -> Optimum:
    """Exact value iteration, with ``added`` F(s, s') or F(s, a, s') on top of the rewards."""
    expected = np.sum(mdp.chances * (mdp.rewards + added), axis=-1)
    v = np.zeros(len(mdp.terminal))
    while True:
        q = expected + mdp.chances @ (mdp.discount * v)
        following = q.max(-1)
        if np.max(np.abs(following - v)) < tolerance:
            return Optimum(np.where(mdp.terminal, 0.0, q.max(-1)), q)
        v = following


def greedy_sets(mdp: FiniteMDP, q: np.ndarray, *, tolerance: float = 1e-8) -> np.ndarray:
    """Which actions are optimal in the non-terminal states ``[ordinary, actions]``."""
    q = q[mdp.ordinary]
    return q >= q.max(-1, keepdims=True) - tolerance
