"""Potential-based reward shaping: Def. 2.1 and Eq. 1.

One rule: F = d·Φ(s') − Φ(s), where d is the very factor that multiplies the bootstrap in the learner's TD target.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.types import Observation, Potential, Scalar, Transition


def shaping_reward(potential: Potential, obs: Observation, discount: Scalar, next_obs: Observation) -> Scalar:
    """Def. 2.1: F(s, a, s') = d·Φ(s') − Φ(s).

    Args:
        potential: Φ, one observation to one number, in units of return.
        obs: s.
        discount: d = γ·(1 − terminated): γ on ordinary and truncated steps, 0 on terminated ones.
        next_obs: s', the true successor (never a reset observation).
    """
    return discount * potential(next_obs) - potential(obs)


def shaped_optimum(optimal_value: Float[Array, "..."], potential_value: Float[Array, "..."]) -> Float[Array, "..."]:
    """Eq. 1: Q*_{M'}(s, a) = Q*_M(s, a) − Φ(s), and V*_{M'}(s) = V*_M(s) − Φ(s).

    Args:
        optimal_value: V* ``[...]``, or Q* with its actions on the last axis ``[..., actions]``.
        potential_value: Φ(s), of V*'s shape, or with a last axis of length one for Q*.
    """
    return optimal_value - potential_value


class Shaping(eqx.Module):
    """R' = R + F for batches of transitions: what a learner is given beside its task.

    Build it with `potential_based`, or, knowing what is lost, with `not_policy_invariant`.

    Attributes:
        potential: Φ.
        terminal_discount: what multiplies Φ at terminal states. Thm. 2.1 needs 0.
    """

    potential: Potential
    terminal_discount: Float[Array, "*batch"] | float = 0.0

    def rewards(self, batch: Transition) -> Float[Array, "n"]:
        """F of each of the transitions ``[n, ...]``."""
        discount = jnp.where(batch.discount == 0, self.terminal_discount, batch.discount)
        return jax.vmap(shaping_reward, in_axes=(None, 0, 0, 0))(self.potential, batch.obs, discount, batch.next_obs)


def potential_based(potential: Potential) -> Shaping:
    """Shaping that leaves every optimal policy optimal (Thm. 2.1): Φ counts as zero at terminal states."""
    return Shaping(potential, jnp.zeros(()))


def not_policy_invariant(potential: Potential, gamma: float) -> Shaping:
    """Shaping with Φ(terminal) left as it is: **not policy-invariant**, Thm. 2.1 does not hold for it.

    Here because people use it, and because it often learns faster; every comparison marks it as what it is.
    """
    return Shaping(potential, jnp.asarray(gamma, jnp.float32))


def shape(batch: Transition, added: Float[Array, "n"] | None) -> Transition:
    """R' = R + F for raw transitions ``[n, ...]``; ``None`` is the unshaped baseline."""
    return batch if added is None else batch._replace(reward=batch.reward + added)
