"""Watches the layers of a wrapped environment from outside while it runs, and makes some of its episodes end early."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.wrappers.observations import misfit

#: Episodes are truncated, terminated, both at once, and left alone (but truncated in the end), in turn.
_FORCED = ((False, True), (True, False), (True, True), (False, True))


@dataclass
class Layer:
    """One environment or wrapper of the chain, and all that it returned.

    Attributes:
        env: the layer.
        calls: what each reset and step of it returned, beside the rewards that it was given.
        given: the raw rewards of the environments that it runs in this process ``[n]``.
        misshapen: the first observation of a sub-environment that does not have the shape it declares: step and words.
    """

    env: Any
    calls: list[tuple] = field(default_factory=list)
    given: np.ndarray | None = None
    misshapen: tuple[int, str] | None = None

    @property
    def name(self) -> str:
        return type(self.env).__name__


@contextmanager
def watched(layers: list[Layer], seed: int, steps: int) -> Iterator[None]:
    """While inside, each layer's ``reset`` and ``step`` leave a record; and innermost environments are made to end."""
    innermost, patience = layers[0].env, max(12, steps // 8)
    originals: list[tuple[Any, str, Any]] = []

    def patch(target: Any, name: str, function: Callable) -> None:
        originals.append((target, name, vars(target).get(name)))
        setattr(target, name, function)

    try:
        if isinstance(innermost, gym.vector.SyncVectorEnv):
            layers[0].given = np.zeros(innermost.num_envs)
            for number, sub in enumerate(innermost.envs):
                _force_ends(sub.unwrapped, patch, seed + number, patience, layers[0].given[number : number + 1])
                for part in {sub.unwrapped: None, sub: None}:
                    _note_shapes(part, patch, layers[0])
        elif isinstance(innermost, gym.Env):
            layers[0].given = np.zeros(1)
            _force_ends(innermost, patch, seed, patience, layers[0].given)
        for below, layer in zip([None, *layers], layers, strict=False):
            patch(layer.env, "reset", _recording_reset(layer, layer.env.reset))
            patch(layer.env, "step", _recording_step(layer, layer.env.step, below))
        yield
    finally:
        for target, name, original in originals[::-1]:
            if original is None:
                delattr(target, name)
            else:
                setattr(target, name, original)


def _force_ends(base: Any, patch: Callable, seed: int, patience: int, rewarded: np.ndarray) -> None:
    """Makes an innermost environment end some episodes early, and note its raw reward in ``rewarded`` ``[1]``.

    An episode that is left alone is truncated after ``patience`` steps: an endless one would leave no time for others.
    """
    rng = np.random.default_rng(seed)
    step, reset = base.step, base.reset
    episode, time, limit = -1, 0, 0

    @wraps(reset)
    def counting_reset(**arguments: Any) -> Any:
        nonlocal episode, time, limit
        episode, time = episode + 1, 0
        is_left_alone = episode % len(_FORCED) == len(_FORCED) - 1
        limit = patience if is_left_alone else int(rng.integers(1, 12))
        return reset(**arguments)

    @wraps(step)
    def ending_step(action: Any) -> Any:
        nonlocal time
        obs, reward, terminated, truncated, info = step(action)
        rewarded[0] = info.get("raw_reward", reward)
        time += 1
        if time == limit:
            force = _FORCED[episode % len(_FORCED)]
            terminated, truncated = terminated or force[0], truncated or force[1]
        return obs, reward, terminated, truncated, info

    patch(base, "reset", counting_reset)
    patch(base, "step", ending_step)


def _note_shapes(sub: gym.Env, patch: Callable, layer: Layer) -> None:
    """Notes where a sub-environment's observation has a wrong shape: its vector fails on that without a clear word."""
    reset, step = sub.reset, sub.step

    def note(obs: Any) -> None:
        words = misfit(sub.observation_space, obs)
        if words and layer.misshapen is None:
            layer.misshapen = (len(layer.calls), words)

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


def _recording_reset(layer: Layer, reset: Callable) -> Callable:
    @wraps(reset)
    def recording_reset(**arguments: Any) -> Any:
        mask = (arguments.get("options") or {}).get("reset_mask")
        mask = None if mask is None else np.array(mask)
        obs, info = reset(**arguments)
        layer.calls.append(("reset", _kept(obs), mask))
        return obs, info

    return recording_reset


def _recording_step(layer: Layer, step: Callable, below: Layer | None) -> Callable:
    @wraps(step)
    def recording_step(action: Any) -> Any:
        mark = 0 if below is None else len(below.calls)
        if layer.given is not None:
            layer.given[:] = 0.0
        obs, reward, terminated, truncated, info = step(action)
        if below is not None:  # more than one call where a wrapper repeats actions
            given = sum(call[2] for call in below.calls[mark:] if call[0] == "step")
        elif layer.given is not None:
            given = layer.given.reshape(np.shape(reward)).copy()
        else:
            given = _told_raw(layer.env, reward, info)
        layer.calls.append(
            ("step", _kept(obs), np.array(reward, np.float64), given, np.array(terminated), np.array(truncated),
             _kept(info.get("final_obs")))
        )  # fmt: skip
        return obs, reward, terminated, truncated, info

    return recording_step


def _told_raw(env: gym.vector.VectorEnv, rewards: Any, infos: dict[str, Any]) -> np.ndarray:
    """The raw rewards behind those of a vector environment; NaN where workers do not tell them in their infos."""
    hides = isinstance(env, gym.vector.AsyncVectorEnv)
    raw = np.full(env.num_envs, np.nan) if hides else np.array(rewards, np.float64)
    for source in (infos, infos.get("final_info") or {}):
        if "raw_reward" in source:
            there = source.get("_raw_reward", np.ones(env.num_envs, bool))
            raw[there] = np.asarray(source["raw_reward"], np.float64)[there]
    return raw


def _kept(obs: Any) -> Any:
    """A copy: environments may write into the array that they returned."""
    if isinstance(obs, dict):
        return {name: _kept(part) for name, part in obs.items()}
    return obs.copy() if isinstance(obs, np.ndarray) else obs
