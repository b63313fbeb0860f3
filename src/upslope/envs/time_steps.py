"""Environments that return one time step, such as xminigrid's, with the signature of gymnax ≥ 1.0."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from upslope.types import Scalar


@dataclass(frozen=True)
class TimeStepEnvironment:
    """Resets automatically, and separates terminations (the discount is zero) from truncations (it is not).

    Attributes:
        env: ``reset(params, key)`` and ``step(params, time_step, action)``, without automatic resets; the time step has
            ``observation``, ``reward``, ``discount`` and ``last()``.
    """

    env: Any

    @property
    def name(self) -> str:
        return type(self.env).__name__

    def action_space(self, params: Any) -> gym.spaces.Discrete:
        return gym.spaces.Discrete(int(self.env.num_actions(params)))

    def observation_space(self, params: Any) -> gym.spaces.Box:
        return gym.spaces.Box(-np.inf, np.inf, self.env.observation_shape(params))

    def reset(self, key: Array, params: Any) -> tuple[Any, Any]:
        time_step = self.env.reset(params, key)
        return time_step.observation, time_step

    def step(
        self, key: Array, state: Any, action: Any, params: Any
    ) -> tuple[Any, Any, Scalar, Bool[Array, ""], Bool[Array, ""], dict[str, Any]]:
        """One step, with automatic reset; see `upslope.envs.cartpole.CartPole.step`."""
        time_step = self.env.step(params, state, action)
        ended = time_step.last()
        terminated = ended & (time_step.discount == 0)
        fresh = self.env.reset(params, key)
        following = jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, time_step)
        info = {"final_observation": time_step.observation}
        return following.observation, following, time_step.reward, terminated, ended & ~terminated, info
