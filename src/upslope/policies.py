"""How learners act: policies are small PyTrees over a batch of observations, so that any family can run them."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.types import Key


class Greedy(eqx.Module):
    """The action of the highest score: Q(s, ·) or A(s, ·)."""

    scores: Callable[..., Float[Array, "actions"]]

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Int[Array, "n"]:
        del key
        return jnp.argmax(jax.vmap(self.scores)(obs), axis=-1)


class EpsilonGreedy(eqx.Module):
    """A uniformly random action with probability ε (one for all, or one for each of the n), else the greedy one."""

    scores: Callable[..., Float[Array, "actions"]]
    epsilon: Float[Array, "..."] | float

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Int[Array, "n"]:
        scores = jax.vmap(self.scores)(obs)
        explore_key, action_key = jax.random.split(key)
        explore = jax.random.uniform(explore_key, scores.shape[:1]) < self.epsilon
        anything = jax.random.randint(action_key, scores.shape[:1], 0, scores.shape[-1])
        return jnp.where(explore, anything, jnp.argmax(scores, axis=-1))


class Noisy(eqx.Module):
    """A deterministic actor's action plus Gaussian noise of standard deviation σ, clipped to [−1, 1]."""

    actor: Callable[..., Float[Array, "actions"]]
    sigma: Any

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Float[Array, "n actions"]:
        action = jax.vmap(self.actor)(obs)
        return jnp.clip(action + self.sigma * jax.random.normal(key, action.shape), -1.0, 1.0)


class Deterministic(eqx.Module):
    """A deterministic actor's own action."""

    actor: Callable[..., Float[Array, "actions"]]

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Float[Array, "n actions"]:
        del key
        return jax.vmap(self.actor)(obs)
