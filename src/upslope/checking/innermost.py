"""Where the raw rewards of the innermost environment come from, and how its episodes are made to end."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float

from upslope.wrappers.observations import misfit

#: How episodes end (terminated, truncated), in turn; the last kind is left alone, but truncated in the end.
_ENDS = ((False, True), (True, False), (True, True), (False, True))

#: Replaces a method of an object until the check is over.
Patch = Callable[[Any, str, Callable], None]


class AbstractInnermost(ABC):
    """The innermost environment of the chain.

    Attributes:
        misfit: the first observation of a sub-environment that does not have the shape of its space: how many calls of
            the vector had been recorded, and the error's words.
    """

    misfit: tuple[int, str] | None = None

    @abstractmethod
    def prepare(self, patch: Patch, seed: int, patience: int, calls: Sequence[Any]) -> None:
        """Makes episodes end early where it can: one that is left alone is truncated after ``patience`` steps."""

    @abstractmethod
    def raw_rewards(self, rewards: Any, infos: dict[str, Any]) -> Float[np.ndarray, "n"]:
        """The raw rewards of the last step; NaN where they are hidden."""


class LocalEnvironments(AbstractInnermost):
    """Environments that run in this process: their ends are forced, and their own rewards are noted."""

    def __init__(self, environments: Sequence[gym.Env], watch_shapes: bool):
        """Takes the environments, wrapped or not, and whether to watch the shapes of their observations."""
        self._environments, self._watch_shapes = environments, watch_shapes
        self._rewards = np.zeros(len(environments))

    def prepare(self, patch: Patch, seed: int, patience: int, calls: Sequence[Any]) -> None:
        for number, env in enumerate(self._environments):
            _force_ends(env.unwrapped, patch, seed + number, patience, self._rewards[number : number + 1])
            for part in {env.unwrapped: None, env: None} if self._watch_shapes else ():
                self._note_shapes(part, patch, calls)

    def raw_rewards(self, rewards: Any, infos: dict[str, Any]) -> Float[np.ndarray, "n"]:
        raw = self._rewards.copy()
        self._rewards[:] = 0.0  # a sub-environment that only resets in the next step has no reward
        return raw

    def _note_shapes(self, sub: gym.Env, patch: Patch, calls: Sequence[Any]) -> None:
        """Notes where an observation has a wrong shape: the vector's own error does not name the cause."""
        reset, step = sub.reset, sub.step

        def note(obs: Any) -> None:
            words = misfit(sub.observation_space, obs)
            if words and self.misfit is None:
                self.misfit = (len(calls), words)

        @wraps(reset)
        def noting_reset(**arguments: Any) -> Any:
            obs, info = reset(**arguments)
            note(obs)
            return obs, info

        @wraps(step)
        def noting_step(action: Any) -> Any:
            obs, *rest = step(action)
            note(obs)
            return obs, *rest

        patch(sub, "reset", noting_reset)
        patch(sub, "step", noting_step)


class RemoteEnvironments(AbstractInnermost):
    """Environments that can't be reached, in worker processes or inside a vector environment of one piece.

    Their raw rewards are those that shaping wrappers inside report; the others are hidden behind worker processes, and
    else the vector's own.
    """

    def __init__(self, count: int, is_hidden: bool):
        self._count, self._is_hidden = count, is_hidden

    def prepare(self, patch: Patch, seed: int, patience: int, calls: Sequence[Any]) -> None:
        """Nothing can be done from here."""

    def raw_rewards(self, rewards: Any, infos: dict[str, Any]) -> Float[np.ndarray, "n"]:
        raw = np.full(self._count, np.nan) if self._is_hidden else np.array(rewards, np.float64)
        for source in (infos, infos.get("final_info") or {}):
            if "raw_reward" in source:
                is_reported = source.get("_raw_reward", np.ones(self._count, bool))
                raw[is_reported] = np.asarray(source["raw_reward"], np.float64)[is_reported]
        return raw


#: How each kind of innermost environment is treated; the first that fits.
_KINDS: tuple[tuple[type, Callable[[Any], AbstractInnermost]], ...] = (
    (gym.vector.SyncVectorEnv, lambda env: LocalEnvironments(env.envs, watch_shapes=True)),
    (gym.vector.AsyncVectorEnv, lambda env: RemoteEnvironments(env.num_envs, is_hidden=True)),
    (gym.vector.VectorEnv, lambda env: RemoteEnvironments(env.num_envs, is_hidden=False)),
    (gym.Env, lambda env: LocalEnvironments([env], watch_shapes=False)),
)


def innermost_of(env: Any) -> AbstractInnermost:
    """How to treat an innermost Gymnasium environment, single or vector."""
    return next(make(env) for kind, make in _KINDS if isinstance(env, kind))


def _force_ends(base: Any, patch: Patch, seed: int, patience: int, rewarded: Float[np.ndarray, "1"]) -> None:
    """Makes an environment end some episodes early, and note its raw reward in ``rewarded``.

    An episode that is left alone is truncated after ``patience`` steps: an endless one would leave no time for others.
    """
    rng = np.random.default_rng(seed)
    step, reset = base.step, base.reset
    episode, time, limit = -1, 0, 0

    @wraps(reset)
    def counting_reset(**arguments: Any) -> Any:
        nonlocal episode, time, limit
        episode, time = episode + 1, 0
        is_left_alone = episode % len(_ENDS) == len(_ENDS) - 1
        limit = patience if is_left_alone else int(rng.integers(1, 12))
        return reset(**arguments)

    @wraps(step)
    def ending_step(action: Any) -> Any:
        nonlocal time
        obs, reward, terminated, truncated, info = step(action)
        rewarded[0] = info.get("raw_reward", reward)
        time += 1
        if time == limit:
            end = _ENDS[episode % len(_ENDS)]
            terminated, truncated = terminated or end[0], truncated or end[1]
        return obs, reward, terminated, truncated, info

    patch(base, "reset", counting_reset)
    patch(base, "step", ending_step)
