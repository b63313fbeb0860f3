"""Policies from hand-made scores: networks that need no training."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


class Scores(eqx.Module):
    """A function from one observation to one number per action, used as a policy's network.

    Attributes:
        function: from an observation to ``[actions]``.
        actions: the number of actions.
    """

    function: Any
    actions: int = eqx.field(static=True, default=4)

    def best(self, obs):
        return jnp.argmax(self.function(obs))

    def random_actions(self, key, count):
        return jax.random.randint(key, (count,), 0, self.actions)


class Fixed(eqx.Module):
    """A deterministic actor that is a function of one observation.

    Attributes:
        function: from an observation to an action ``[actions]``.
        actions: the number of components of an action.
    """

    function: Any
    actions: int = eqx.field(static=True, default=1)

    def best(self, obs):
        return self.function(obs)
