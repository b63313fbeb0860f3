"""Adapts environments with the signature of gymnax ≥ 1.0 to the learners here."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from upslope.types import Scalar


@dataclass(frozen=True)
class FittedEnvironment:
    """Observations are one array of floats, actions go from 0 to n − 1 or lie in [−1, 1], successors are the true ones.

    A step that terminates at the time limit is terminated, not truncated.

    Attributes:
        env: ``reset(key, params)`` and the six-value ``step(key, state, action, params)``.
        observations: the number of different observations where an observation is an integer; else 0.
        observation_shape: of one observation: a vector, or an image ``[height, width, channels]``.
        action_shape: of a continuous action of the environment; None for discrete ones.
    """

    env: Any
    observations: int
    observation_shape: tuple[int, ...]
    action_shape: tuple[int, ...] | None

    def reset(self, key: Array, params: Any) -> tuple[Float[Array, "*obs"], Any]:
        obs, state = self.env.reset(key, params)
        return self._fit(obs), state

    def step(
        self, key: Array, state: Any, action: Any, params: Any
    ) -> tuple[Float[Array, "*obs"], Any, Scalar, Bool[Array, ""], Bool[Array, ""], dict[str, Array]]:
        """One step, with the environment's own automatic reset.

        Returns:
            Observation to act on, state, reward, terminated, truncated, and ``info["final_observation"]``.
        """
        obs, state, reward, terminated, truncated, info = self.env.step(key, state, self._push(action, params), params)
        terminated = jnp.asarray(terminated, bool).reshape(())
        truncated = jnp.asarray(truncated, bool).reshape(()) & ~terminated
        final = {"final_observation": self._fit(info["final_observation"])}
        return self._fit(obs), state, jnp.asarray(reward, jnp.float32).reshape(()), terminated, truncated, final

    def _fit(self, obs: Any) -> Float[Array, "*obs"]:
        if self.observations:
            return jax.nn.one_hot(jnp.reshape(obs, ()), self.observations, dtype=jnp.float32)
        leaves = [jnp.ravel(leaf).astype(jnp.float32) for leaf in jax.tree.leaves(obs)]
        return jnp.concatenate(leaves).reshape(self.observation_shape)

    def _push(self, action: Any, params: Any) -> Any:
        """The action in the environment's own units; bounds may differ from task to task."""
        if self.action_shape is None:
            return action
        space = self.env.action_space(params)
        share = (jnp.reshape(action, self.action_shape) + 1) / 2
        return space.low + share * (jnp.asarray(space.high) - space.low)
