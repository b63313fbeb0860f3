"""Watches the layers of a wrapped environment from outside while it runs, and makes some of its episodes end early."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

import gymnasium as gym
import numpy as np

#: Episodes are left alone, truncated, terminated, and both at once, in turn.
_FORCED = ((False, False), (False, True), (True, False), (True, True))


@dataclass
class Layer:
    """One environment or wrapper of the chain, and all that it returned.

    Attributes:
        env: the layer.
        calls: what each reset and step of it returned, beside the rewards that it was given.
        given: the innermost raw rewards of a vector of environments, which are not layers of their own ``[n]``.
    """

    env: Any
    calls: list[tuple] = field(default_factory=list)
    given: np.ndarray | None = None

    @property
    def name(self) -> str:
        return type(self.env).__name__


@contextmanager
def watched(layers: list[Layer], seed: int) -> Iterator[None]:
    """While inside, each layer's ``reset`` and ``step`` leave a record; and innermost environments are made to end."""
    innermost = layers[0].env
    originals: list[tuple[Any, str, Any]] = []

    def patch(target: Any, name: str, function: Callable) -> None:
        originals.append((target, name, vars(target).get(name)))
        setattr(target, name, function)

    try:
        if isinstance(innermost, gym.vector.SyncVectorEnv):
            layers[0].given = np.zeros(innermost.num_envs)
            for number, sub in enumerate(innermost.envs):
                _force_ends(sub.unwrapped, patch, seed + number, layers[0].given[number : number + 1])
        elif isinstance(innermost, gym.Env):
            _force_ends(innermost, patch, seed, np.zeros(1))
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


def _force_ends(base: Any, patch: Callable, seed: int, rewarded: np.ndarray) -> None:
    """Makes an innermost environment end some episodes early, and note its raw reward in ``rewarded`` ``[1]``."""
    rng = np.random.default_rng(seed)
    step, reset = base.step, base.reset
    episode, time, limit = -1, 0, 0

    @wraps(reset)
    def counting_reset(**arguments: Any) -> Any:
        nonlocal episode, time, limit
        episode, time, limit = episode + 1, 0, int(rng.integers(2, 12))
        return reset(**arguments)

    @wraps(step)
    def ending_step(action: Any) -> Any:
        nonlocal time
        obs, reward, terminated, truncated, info = step(action)
        rewarded[0] = reward
        time += 1
        if time == limit:
            force = _FORCED[episode % len(_FORCED)]
            terminated, truncated = terminated or force[0], truncated or force[1]
        return obs, reward, terminated, truncated, info

    patch(base, "reset", counting_reset)
    patch(base, "step", ending_step)


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
        given = 0.0 if layer.given is None else layer.given.copy()
        if below is not None:  # more than one call where a wrapper repeats actions
            given = sum(call[2] for call in below.calls[mark:] if call[0] == "step")
        layer.calls.append(
            ("step", _kept(obs), np.array(reward, np.float64), given, np.array(terminated), np.array(truncated),
             _kept(info.get("final_obs")))
        )  # fmt: skip
        return obs, reward, terminated, truncated, info

    return recording_step


def _kept(obs: Any) -> Any:
    """A copy: environments may write into the array that they returned."""
    if isinstance(obs, dict):
        return {name: _kept(part) for name, part in obs.items()}
    return obs.copy() if isinstance(obs, np.ndarray) else obs
