"""One place in a vector of environments, whose task can change, and the spaces that learners accept.

Runs in simulator processes, and needs no JAX.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import FlattenObservation, RescaleAction

from upslope.errors import UpslopeError

#: The fully connected layer after the convolutions has 4,096 weights for each pixel.
MOST_PIXELS = 64 * 64

#: Images whose first axis is at most this long, and whose others are longer, seem to have their channels first.
_MOST_CHANNELS = 4


@dataclass(frozen=True)
class EnvironmentFactory:
    """Makes environments, and gives them new tasks where that is possible.

    Attributes:
        make_env: ``make_env(task) -> gymnasium.Env``.
        give_task: ``give_task(env, task)`` gives a new task to an environment that ``make_env`` returned, before its
            next reset. None makes a new environment for every task.
    """

    make_env: Callable[[Any], gym.Env]
    give_task: Callable[[gym.Env, Any], None] | None = None

    def set_task(self, env: gym.Env, task: Any) -> bool:
        """Gives a task to an environment; False if it needs a new one.

        Raises:
            UpslopeError: the user's function fails.
        """
        if self.give_task is None:
            return False
        try:
            self.give_task(env, task)
        except Exception as error:
            raise UpslopeError(
                f"set_task failed for the task {task!r} ({type(error).__name__}: {error}): it must give any task to "
                "any environment that make_env returned."
            ) from error
        return True


class TaskSlot(gym.Env):
    """Runs the environment of its task; a new task takes effect at the next reset.

    Attributes:
        task: the argument of the factory.
    """

    def __init__(self, factory: EnvironmentFactory, observation_space: gym.Space, action_space: gym.Space):
        """Takes the factory, and the spaces that its environments must have after `fit_spaces`."""
        self.observation_space, self.action_space = observation_space, action_space
        self._factory = factory
        self._task: Any = None
        self._own: gym.Env | None = None
        self._env: gym.Env | None = None

    @property
    def task(self) -> Any:
        return self._task

    @task.setter
    def task(self, task: Any) -> None:
        if self._own is None or not self._factory.set_task(self._own, task):
            self.close()
        self._task = task

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode of the task.

        Raises:
            UpslopeError: the factory fails, or its environment has other spaces than earlier ones.
        """
        if self._env is None:
            self._own = make_environment(self._factory.make_env, self._task)
            self._env = fit_spaces(self._own)
            theirs = (self._env.observation_space.shape, self._env.action_space)
            if theirs != (self.observation_space.shape, self.action_space):
                raise UpslopeError(
                    f"For the task {self._task!r} make_env gave observations of shape {theirs[0]} and actions "
                    f"{theirs[1]}, but {self.observation_space.shape} and {self.action_space} before: a family shares "
                    "its spaces."
                )
        obs, _ = self._env.reset(seed=seed, options=options)
        return self._checked(obs), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        assert self._env is not None
        obs, reward, terminated, truncated, _ = self._env.step(action)
        # Infos are dropped: they are not needed, and gathering them would cost more than the step.
        return self._checked(obs), float(reward), bool(terminated), bool(truncated), {}

    def close(self) -> None:
        if self._env is not None:
            self._env.close()
            self._own = self._env = None

    def _checked(self, obs: Any) -> np.ndarray:
        if np.shape(obs) != self.observation_space.shape:
            raise UpslopeError(
                f"An environment gave an observation of shape {np.shape(obs)}, but its observation space says "
                f"{self.observation_space.shape}: fix its observation_space, or what changes the shape."
            )
        return np.asarray(obs, np.float32)


def make_environment(make_env: Callable[[Any], gym.Env], task: Any) -> gym.Env:
    """The environment of a task.

    Raises:
        UpslopeError: the factory fails or returns no environment.
    """
    try:
        env = make_env(task)
    except Exception as error:
        raise UpslopeError(
            f"make_env failed for the task {task!r} ({type(error).__name__}: {error}): it must make an environment "
            "for every task that is sampled."
        ) from error
    if not isinstance(env, gym.Env):
        raise UpslopeError(f"make_env returned {type(env).__name__}: return a gymnasium.Env.")
    return env


def fit_spaces(env: gym.Env) -> gym.Env:
    """Wraps an environment: observations are one vector or an image, actions 0 to n − 1 or numbers in [−1, 1].

    Raises:
        UpslopeError: a space that can't be converted.
    """
    space, actions = env.observation_space, env.action_space
    if not (isinstance(space, gym.spaces.Box) and len(space.shape) in (1, 3)):
        if not space.is_np_flattenable:
            raise UpslopeError(f"Observations of {space} can't be flattened: use Box, Discrete, Dict or Tuple spaces.")
        env = FlattenObservation(env)
    elif len(space.shape) == 3 and space.shape[0] <= _MOST_CHANNELS and min(space.shape[1:]) > 8:
        raise UpslopeError(
            f"Images of shape {space.shape} seem to have their channels first: move them last, with "
            "gymnasium.wrappers.TransformObservation and numpy.moveaxis(obs, 0, -1)."
        )
    elif len(space.shape) == 3 and space.shape[0] * space.shape[1] > MOST_PIXELS:
        raise UpslopeError(
            f"Images of {space.shape[0]} × {space.shape[1]} pixels are too large for convolutions without a stride: "
            f"shrink them to at most {MOST_PIXELS} pixels with gymnasium.wrappers.ResizeObservation."
        )
    if isinstance(actions, gym.spaces.Discrete):
        return env if actions.start == 0 else gym.wrappers.TransformAction(
            env, lambda action: action + actions.start, gym.spaces.Discrete(int(actions.n))
        )  # fmt: skip
    one_axis = isinstance(actions, gym.spaces.Box) and len(actions.shape) == 1 and actions.is_bounded()
    if not (isinstance(actions, gym.spaces.Box) and one_axis and np.issubdtype(actions.dtype, np.floating)):
        raise UpslopeError(
            f"Actions of {actions} are not supported: use Discrete, or a Box of floats of one axis with finite bounds; "
            "gymnasium.wrappers.TransformAction converts other spaces."
        )
    ones = np.ones(actions.shape, actions.dtype)
    return RescaleAction(env, -ones, ones)
