"""Runs a wrapped environment and records what every layer of wrappers does to the reward, without changing any of them.

Ends are forced too, at the innermost environment: random actions alone seldom show a truncation.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import Autoreset

from upslope.checking.watching import Layer, watched
from upslope.errors import UpslopeError


class Seen(NamedTuple):
    """One transition of one environment, as a layer shows it.

    Attributes:
        obs: s.
        successor: s', the true one; None where the layer hides it.
        shown: what the layer returned; another observation than s' only where it resets in the same step.
        reward: that the layer returned.
        below: the reward that it was given.
        terminated: whether the episode terminated.
        truncated: whether it was truncated.
        dummy: the step that resets under next-step autoreset; no transition.
        first: of its episode.
        last_before: the last observation of the episode before, if any.
        step: when, in steps of the layer.
        age: when, in transitions of this environment: steps that reset are not counted.
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


class Recording(NamedTuple):
    """The layers from the innermost outwards, and what went wrong while running, if anything did."""

    layers: list[Layer]
    trouble: Exception | None

    def last_observations(self, index: int) -> list[Any]:
        """What the layer of this number returned last."""
        layer = self.layers[index]
        if not layer.calls:
            return []
        obs = layer.calls[-1][1]
        return (
            [_one(obs, i) for i in range(layer.env.num_envs)] if isinstance(layer.env, gym.vector.VectorEnv) else [obs]
        )

    def transitions(self, index: int) -> list[Seen]:
        """Everything that the layer of this number showed."""
        layer = self.layers[index]
        return list(_of_vector(layer) if isinstance(layer.env, gym.vector.VectorEnv) else _of_single(layer))


def record(env: Any, steps: int, seed: int) -> Recording:
    """Plays random actions for so many steps.

    Raises:
        UpslopeError: no Gymnasium environment.
    """
    if not isinstance(env, gym.Env | gym.vector.VectorEnv):
        raise _no_environment(env)
    layers = [Layer(layer) for layer in _chain(env)]
    trouble = None
    with watched(layers, seed, steps):
        try:
            _play(env, steps, seed)
        except Exception as error:
            trouble = error
    return Recording(layers, trouble)


def _no_environment(env: Any) -> UpslopeError:
    # Told by name: Stable-Baselines3 need not be installed.
    kinds = {(kind.__module__.split(".")[0], kind.__name__) for kind in type(env).__mro__}
    if ("stable_baselines3", "VecEnv") in kinds:
        return UpslopeError(
            f"{type(env).__name__} is a vector environment of Stable-Baselines3, which is not judged: check one "
            "environment of it instead, shaped by upslope.PotentialShaping or by a wrapper of your own."
        )
    return UpslopeError(
        f"{type(env).__name__} is no Gymnasium environment: give a gymnasium.Env or a gymnasium.vector.VectorEnv."
    )


def _chain(env: Any) -> list[Any]:
    """From the innermost environment to the outermost wrapper."""
    chain = [env]
    while isinstance(chain[-1], gym.Wrapper | gym.vector.VectorWrapper):
        chain.append(chain[-1].env)
    return chain[::-1]


def _play(env: Any, steps: int, seed: int) -> None:
    env.action_space.seed(seed)
    env.reset(seed=seed)
    resets_itself = isinstance(env, gym.vector.VectorEnv) and env.metadata["autoreset_mode"] != AutoresetMode.DISABLED
    resets_itself = resets_itself or any(isinstance(layer, Autoreset) for layer in _chain(env))
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        done = np.logical_or(terminated, truncated)
        if not resets_itself and np.any(done):
            # The options are made anew: Gymnasium takes the mask out of them.
            env.reset(options={"reset_mask": done}) if np.ndim(done) else env.reset()


def _of_single(layer: Layer) -> Iterator[Seen]:
    current, first, before, resetting = None, True, None, False
    step = age = 0
    for call in layer.calls:
        obs = call[1]
        if call[0] == "reset":
            before, current, first, resetting = (current if not first else before), obs, True, False
            continue
        _, _, reward, given, terminated, truncated, _ = call
        step, age = step + 1, age + (not resetting)
        yield Seen(
            current, obs, obs, float(reward), float(given), bool(terminated), bool(truncated), resetting, first,
            before, step, age,
        )  # fmt: skip
        if resetting:
            before = current
        first, resetting = resetting, bool(terminated or truncated)
        current = obs


def _of_vector(layer: Layer) -> Iterator[Seen]:
    mode = AutoresetMode(layer.env.metadata["autoreset_mode"])
    for i in range(layer.env.num_envs):
        current, first, before, resetting = None, True, None, False
        step = age = 0
        for call in layer.calls:
            obs = _one(call[1], i)
            if call[0] == "reset":
                if call[2] is None or call[2][i]:
                    before, current, first, resetting = (current if not first else before), obs, True, False
                continue
            _, _, reward, given, terminated, truncated, finals = call
            step, age = step + 1, age + (not resetting)
            done = bool(terminated[i] or truncated[i])
            same = mode is AutoresetMode.SAME_STEP and done
            hidden = same and (finals is None or finals[i] is None)
            successor = None if hidden else finals[i] if same else obs
            below = float(np.broadcast_to(given, np.shape(reward))[i])
            if resetting and np.isnan(below):  # a reset has no raw reward to tell
                below = float(reward[i])
            yield Seen(
                current, successor, obs, float(reward[i]), below, bool(terminated[i]), bool(truncated[i]), resetting,
                first, before, step, age,
            )  # fmt: skip
            if resetting:
                before = current
            if same:
                before = successor
            first = resetting or same
            resetting = done and mode is AutoresetMode.NEXT_STEP
            current = obs


def _one(batch: Any, index: int) -> Any:
    if isinstance(batch, dict):
        return {name: _one(part, index) for name, part in batch.items()}
    return tuple(_one(part, index) for part in batch) if isinstance(batch, tuple) else batch[index]
