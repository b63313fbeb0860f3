"""Eqs. 4 to 9, one function each: small, unbatched, for one transition. Map over batches at the call site."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.types import Scalar

ActionValues = Float[Array, "actions"]
ActionIndex = Int[Array, ""]


def prior_error(potential: Scalar, optimal_value: Scalar) -> Scalar:
    """Eq. 4: (Φ(s; θ) − V*(s))², the objective that can't be had without knowing V*."""
    return (potential - optimal_value) ** 2


def td_loss(q: ActionValues, action: ActionIndex, reward: Scalar, discount: Scalar, next_q: ActionValues) -> Scalar:
    """Eq. 5: (R + d·max_a' Q(s', a') − Q(s, a))².

    The gradient flows wherever the caller lets it: pass ``stop_gradient(next_q)`` for the semi-gradient.
    """
    return td_error(q, action, reward, discount, next_q) ** 2


def td_error(q: ActionValues, action: ActionIndex, reward: Scalar, discount: Scalar, next_q: ActionValues) -> Scalar:
    """R + d·max_a' Q(s', a') − Q(s, a), what Eq. 5 squares."""
    return reward + discount * jnp.max(next_q) - q[action]


def huber(error: Scalar, threshold: float) -> Scalar:
    """A squared error that grows only linearly beyond the threshold.

    Shaping by Φ pays −Φ(s) at a failure: an outlier that the squared TD error of a vanilla learner overreacts to.
    """
    size = jnp.abs(error)
    squared_part = jnp.minimum(size, threshold)
    return squared_part * (2 * size - squared_part)


def dueling_q(value: Scalar, advantage: ActionValues) -> ActionValues:
    """Eq. 6: Q(s, a) = V(s) + A(s, a) − max_a' A(s, a'), so that V(s) = max_a Q(s, a) exactly.

    The maximum, not the mean of common dueling networks: with the mean, V is not the optimal value.
    """
    return value + (advantage - jnp.max(advantage))


def prior_learning_loss(q_prior: ActionValues, q_posterior: ActionValues, action: ActionIndex) -> Scalar:
    """Eq. 7: (Q_θ(s, a) − Q_φ(s, a))², at the action taken."""
    return (q_prior[action] - q_posterior[action]) ** 2


def advantage_loss(
    advantage: ActionValues, action: ActionIndex, shaped_reward: Scalar, discount: Scalar, next_advantage: ActionValues
) -> Scalar:
    """Eq. 8: (R' + d·max_a' A(s', a') − A(s, a))²: Q-learning on the shaped task, with the A head as its Q."""
    return td_loss(advantage, action, shaped_reward, discount, next_advantage)


def value_loss(value: Scalar, advantage: ActionValues) -> Scalar:
    """Eq. 9: (V(s) − stop_gradient(max_a A(s, a) + V(s)))²."""
    return (value - jax.lax.stop_gradient(jnp.max(advantage) + value)) ** 2
