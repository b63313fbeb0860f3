"""The interface between families and their environments on the host: a policy goes out, whole transitions come back."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

#: A policy in NumPy: the number of a step and observations ``[n, *obs]`` to actions ``[n, ...]``.
Act: TypeAlias = Callable[[int, np.ndarray], np.ndarray]


class Trajectories(NamedTuple):
    """Consecutive transitions of ``n`` environments ``[n, steps, ...]``.

    When an episode ends, its environment starts the next one, so a trajectory may hold several episodes.

    Attributes:
        obs: before each step, in float32.
        action: as the policy chose it, in int32 or float32.
        reward: in float32.
        terminated: whether the episode ended for good; False if it was only truncated.
        next_obs: the true successor, also at the end of an episode, in float32.
    """

    obs: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    next_obs: np.ndarray


class AbstractRollouts(ABC):
    """Runs policies in environments. A backend decides where these run, and in how many processes.

    No call crosses this interface once per step, so a backend may send policies to where its environments are. Then it
    has to pickle them.

    In all methods ``tasks`` are ``n`` arguments of the environments' factory, ``seed`` is any number of up to 64 bits
    and ``act`` is the policy. All raise `UpslopeError` if an environment can't be made or fails in a known way.
    """

    @property
    @abstractmethod
    def seconds(self) -> float:
        """Time spent inside environments so far, with their factories and with the transfer of data."""

    @abstractmethod
    def rollout(self, tasks: Sequence[Any], seed: int, act: Act, steps: int) -> Trajectories:
        """Takes steps from the start of new episodes, which are abandoned afterwards."""

    @abstractmethod
    def returns(self, tasks: Sequence[Any], seed: int, act: Act, steps: int) -> np.ndarray:
        """The undiscounted return ``[n]``, in float32, of one new episode of each task.

        Args:
            tasks: see the class.
            seed: see the class.
            act: see the class.
            steps: the longest episode.
        """

    @abstractmethod
    def start(self, tasks: Sequence[Any], seed: int) -> int:
        """Starts a group of episodes that continue from one `collect` to the next. Returns the number of the group."""

    @abstractmethod
    def knows(self, number: int, count: int) -> bool:
        """Whether `collect` can continue the group of this number, and whether it has ``count`` environments."""

    @abstractmethod
    def collect(self, number: int, act: Act, steps: int) -> Trajectories:
        """Takes steps in a group of environments, from where the last call left them."""

    @abstractmethod
    def close(self) -> None:
        """Closes all environments and forgets all groups. Later calls make new ones."""
