"""A JAX environment with gymnax's signature whose every transition is known by hand."""

from dataclasses import dataclass

import equinox as eqx
import gymnasium as gym
import jax
import jax.numpy as jnp


class Params(eqx.Module):
    """Terminates when the count is at ``goal``, is truncated after ``max_steps_in_episode``."""

    goal: jax.Array | int
    max_steps_in_episode: jax.Array | int = 6


@dataclass(frozen=True)
class Counting:
    """Counts up by the action (0, 1, 2); episodes begin at 0. ``observes`` selects the observation."""

    observes: str = "vector"
    push: float = 0.0

    def observation_space(self, params):
        return {
            "vector": gym.spaces.Box(-50.0, 50.0, (2,)),
            "number": gym.spaces.Discrete(10),
            "image": gym.spaces.Box(0, 255, (3, 4, 2)),
            "parts": gym.spaces.Dict({"a": gym.spaces.Discrete(9), "b": gym.spaces.Box(-1, 1, (2, 2))}),
        }[self.observes]

    def action_space(self, params):
        if self.push:
            return gym.spaces.Box(0.0, self.push, (1,))
        return gym.spaces.Discrete(3)

    def observe(self, count):
        return {
            "vector": jnp.stack([count, 2 * count]),
            "number": count,
            "image": jnp.full((3, 4, 2), count, jnp.uint8),
            "parts": {"a": count, "b": jnp.full((2, 2), 0.5)},
        }[self.observes]

    def reset(self, key, params):
        return self.observe(jnp.zeros((), jnp.int32)), (jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))

    def step(self, key, state, action, params):
        count = state[0] + jnp.asarray(jnp.sum(action), jnp.int32)
        time = state[1] + 1
        terminated, truncated = count >= params.goal, time >= params.max_steps_in_episode
        done = terminated | truncated
        obs, fresh = self.reset(key, params)
        following = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, (count, time))
        final = self.observe(count)
        shown = jax.tree.map(lambda new, old: jnp.where(done, new, old), obs, final)
        return shown, following, -count, terminated, truncated, {"final_observation": final}


class OldStyle(Counting):
    """Five values, as before gymnax 1.0."""

    def step(self, key, state, action, params):
        obs, state, reward, terminated, truncated, info = super().step(key, state, action, params)
        return obs, state, reward, terminated | truncated, info
