"""Continuous actions of a JAX environment as a grid of discrete ones."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


class DiscreteSpace(NamedTuple):
    """The integers from 0 to n − 1."""

    n: int


@dataclass(frozen=True)
class JointGrid:
    """An environment of gymnax's signature whose boxed actions are replaced by all combinations of a few forces.

    As `gymnasium.wrappers.DiscretizeAction` does for Gymnasium, but with the strongest forces among the few, where that
    has the middles of equal bins. The number of actions is ``bins`` to the power of the components of an action: fine
    up to three.

    Attributes:
        env: with continuous actions.
        bins: evenly spaced numbers for each component, the bounds among them.
    """

    env: Any
    bins: int = 3

    @property
    def name(self) -> str:
        return self.env.name

    def reset(self, key: Array, params: Any) -> tuple[Any, Any]:
        return self.env.reset(key, params)

    def step(self, key: Array, state: Any, action: Any, params: Any) -> tuple:
        """One step with the action of this number; the last component changes fastest."""
        space = self.env.action_space(params)
        digits = jnp.stack(jnp.unravel_index(action, (self.bins,) * self._components(params)))
        share = digits.reshape(space.shape) / (self.bins - 1)
        return self.env.step(key, state, space.low + share * (jnp.asarray(space.high) - space.low), params)

    def action_space(self, params: Any) -> DiscreteSpace:
        return DiscreteSpace(self.bins ** self._components(params))

    def observation_space(self, params: Any) -> Any:
        return self.env.observation_space(params)

    def _components(self, params: Any) -> int:
        return math.prod(np.shape(np.zeros(self.env.action_space(params).shape)))
