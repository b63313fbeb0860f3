"""The layers of a wrapped environment: single or vector, each with a record of its calls."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import Autoreset
from jaxtyping import Bool

from upslope.checking.calls import Autoresets, Episodes, LayerTransition, ResetCall, StepCall
from upslope.errors import UpslopeError
from upslope.wrappers.dispatch import VEC_ENV
from upslope.wrappers.vector import autoreset_mode


class AbstractLayer(ABC):
    """One environment or wrapper of the chain.

    Attributes:
        env: the layer itself.
        calls: what each of its resets and steps returned.
        count: the number of environments in it.
        space: of one observation.
        autoresets: when its environments reset without being asked.
        resets_itself: whether the layer resets the environments in it.
    """

    env: Any
    calls: list[ResetCall | StepCall]
    count: int
    space: gym.Space
    autoresets: Autoresets
    resets_itself: bool

    @abstractmethod
    def singles(self, batch: Any) -> Sequence[Any]:
        """The values of each environment, from what the layer returns ``[n]``."""

    @abstractmethod
    def reset_done(self, done: Any) -> None:
        """Resets the environments whose episodes are done."""

    @property
    def name(self) -> str:
        return type(self.env).__name__

    @property
    def last_observations(self) -> Sequence[Any]:
        """The observations that the layer returned last."""
        return self.calls[-1].observations if self.calls else ()

    @property
    def transitions(self) -> list[LayerTransition]:
        """All transitions of the first environment, then those of the next one, and so on."""
        seen: list[LayerTransition] = []
        for index in range(self.count):
            episodes = Episodes(self.autoresets)
            for call in self.calls:
                seen.extend(call.replay(episodes, index))
        return seen

    def add_reset(self, obs: Any, begins: Bool[np.ndarray, "n"] | None) -> None:
        """Records a reset, of all environments or of some."""
        begins = np.ones(self.count, bool) if begins is None else begins
        self.calls.append(ResetCall(self.singles(deepcopy(obs)), begins))

    def add_step(self, result: tuple, given: Any) -> None:
        """Records what a step returned, and the rewards that the layer was given ``[n]``."""
        obs, rewards, terminated, truncated, infos = result
        finals = infos.get("final_obs") if self.autoresets.same_step else None
        # Copies: environments may write into the arrays that they returned.
        self.calls.append(
            StepCall(
                self.singles(deepcopy(obs)),
                np.array(rewards, np.float64).reshape(self.count),
                np.broadcast_to(np.asarray(given, np.float64), (self.count,)),
                np.array(terminated, bool).reshape(self.count),
                np.array(truncated, bool).reshape(self.count),
                [None] * self.count if finals is None else deepcopy(finals),
            )
        )


class SingleLayer(AbstractLayer):
    """A Gymnasium environment. A step after the end of an episode can only be one that resets."""

    autoresets = Autoresets(same_step=False, next_step=True)
    count = 1

    def __init__(self, env: gym.Env):
        self.env, self.calls = env, []
        self.space = env.observation_space
        self.resets_itself = isinstance(env, Autoreset)

    def singles(self, batch: Any) -> Sequence[Any]:
        return [batch]

    def reset_done(self, done: Any) -> None:
        self.env.reset()


class VectorLayer(AbstractLayer):
    """A Gymnasium vector environment."""

    def __init__(self, env: gym.vector.VectorEnv):
        self.env, self.calls = env, []
        self.count, self.space = env.num_envs, env.single_observation_space
        mode = autoreset_mode(env)
        self.autoresets = Autoresets(mode is AutoresetMode.SAME_STEP, mode is AutoresetMode.NEXT_STEP)
        self.resets_itself = any(self.autoresets)

    def singles(self, batch: Any) -> Sequence[Any]:
        return [_one(batch, index) for index in range(self.count)]

    def reset_done(self, done: Any) -> None:
        # New options every time: Gymnasium takes the mask out of them.
        self.env.reset(options={"reset_mask": np.asarray(done)})


_KINDS: tuple[tuple[type, Callable[[Any], AbstractLayer]], ...] = (
    (gym.Env, SingleLayer),
    (gym.vector.VectorEnv, VectorLayer),
)


def layers_of(env: Any) -> list[AbstractLayer]:
    """From the innermost environment to the outermost wrapper.

    Raises:
        UpslopeError: not a Gymnasium environment.
    """
    layers = [_layer(env)]
    while isinstance(layers[-1].env, gym.Wrapper | gym.vector.VectorWrapper):
        layers.append(_layer(layers[-1].env.env))
    return layers[::-1]


def _layer(env: Any) -> AbstractLayer:
    for base, kind in _KINDS:
        if isinstance(env, base):
            return kind(env)
    if VEC_ENV.includes(env):
        raise UpslopeError(
            f"{type(env).__name__} is a vector environment of Stable-Baselines3, which can't be checked: check one "
            "environment of it instead, shaped by upslope.PotentialShaping or by a wrapper of your own."
        )
    raise UpslopeError(
        f"{type(env).__name__} is not a Gymnasium environment: give a gymnasium.Env or a gymnasium.vector.VectorEnv."
    )


def _one(batch: Any, index: int) -> Any:
    """One observation of a batch, which need not fit the space."""
    if isinstance(batch, dict):
        return {name: _one(part, index) for name, part in batch.items()}
    return tuple(_one(part, index) for part in batch) if isinstance(batch, tuple) else batch[index]
