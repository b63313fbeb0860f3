"""Shaping of a learner's batches: R' = R + F, with F by Def. 2.1 (`upslope.equations.shaping`)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.equations.shaping import shaping_reward
from upslope.types import Observation, Potential, Scalar, Transition


class Shaping(eqx.Module):
    """Shaping rewards F for batches of transitions.

    Build it with `potential_based`, or with `not_policy_invariant` if Thm. 2.1 need not hold.

    Attributes:
        potential: Φ.
        terminal_discount: the factor of Φ at terminal states. Thm. 2.1 needs 0.
    """

    potential: Potential
    terminal_discount: Float[Array, "*batch"] | float = 0.0

    def rewards(self, batch: Transition) -> Float[Array, "n"]:
        """F of each transition ``[n, ...]``."""

        def f(obs: Observation, discount: Scalar, next_obs: Observation) -> Scalar:
            return shaping_reward(self.potential(obs), discount, self.potential(next_obs))

        discount = jnp.where(batch.discount == 0, self.terminal_discount, batch.discount)
        return jax.vmap(f)(batch.obs, discount, batch.next_obs)


def potential_based(potential: Potential) -> Shaping:
    """Shaping that leaves every optimal policy optimal (Thm. 2.1): Φ counts as zero at terminal states."""
    return Shaping(potential, jnp.zeros(()))


def not_policy_invariant(potential: Potential, gamma: float) -> Shaping:
    """Shaping that keeps Φ at terminal states: **not policy-invariant**, Thm. 2.1 does not hold for it.

    It is included because people use it and learning is often faster with it. Every comparison labels it.
    """
    return Shaping(potential, jnp.asarray(gamma, jnp.float32))


def add_shaping(batch: Transition, added: Float[Array, "n"] | None) -> Transition:
    """Adds F to the raw rewards of transitions ``[n, ...]``; ``None`` is the unshaped baseline."""
    return batch if added is None else batch._replace(reward=batch.reward + added)
