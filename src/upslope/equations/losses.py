"""Eqs. 4 to 9, one function each, for one transition. Map over batches at the call site.

Losses take Q(s, a) and V(s'), not a table of actions, so that they fit every kind of action.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp

from upslope.types import Scalar

#: Numbers, or arrays of NumPy or JAX.
Numbers = TypeVar("Numbers")


def prior_error(potential: Scalar, optimal_value: Scalar) -> Scalar:
    """Eq. 4: (Φ(s; θ) − V*(s))², the objective that can't be computed without V*."""
    return (potential - optimal_value) ** 2


def td_loss(q: Scalar, reward: Scalar, discount: Scalar, next_value: Scalar) -> Scalar:
    """Eq. 5: (R + d·max_a' Q(s', a') − Q(s, a))².

    The gradient flows wherever the caller lets it: pass ``stop_gradient(next_value)`` for the semi-gradient.
    """
    return td_error(q, reward, discount, next_value) ** 2


def td_error(q: Scalar, reward: Scalar, discount: Scalar, next_value: Scalar) -> Scalar:
    """R + d·max_a' Q(s', a') − Q(s, a), the difference that Eq. 5 squares."""
    return reward + discount * next_value - q


def huber(error: Scalar, threshold: float) -> Scalar:
    """A squared error that grows only linearly beyond the threshold.

    Shaping by Φ pays −Φ(s) at a failure: an outlier that the squared TD error of a vanilla learner overreacts to.
    """
    size = jnp.abs(error)
    squared_part = jnp.minimum(size, threshold)
    return squared_part * (2 * size - squared_part)


def dueling_q(value: Numbers, advantage: Numbers, highest_advantage: Numbers) -> Numbers:
    """Eq. 6: Q(s, a) = V(s) + A(s, a) − max_a' A(s, a'), so that V(s) = max_a Q(s, a) exactly.

    The maximum, not the mean of common dueling networks: with the mean, V is not the optimal value.
    """
    return value + (advantage - highest_advantage)  # type: ignore[operator]


def prior_learning_loss(q_prior: Numbers, q_posterior: Numbers) -> Numbers:
    """Eq. 7: (Q_θ(s, a) − Q_φ(s, a))², at the action taken."""
    return (q_prior - q_posterior) ** 2  # type: ignore[operator]


def advantage_loss(
    advantage: Scalar, shaped_reward: Scalar, discount: Scalar, highest_next_advantage: Scalar
) -> Scalar:
    """Eq. 8: (R' + d·max_a' A(s', a') − A(s, a))²: Q-learning on the shaped task, with the A head as its Q."""
    return td_loss(advantage, shaped_reward, discount, highest_next_advantage)


def value_loss(value: Scalar, highest_advantage: Scalar) -> Scalar:
    """Eq. 9: (V(s) − stop_gradient(max_a A(s, a) + V(s)))²."""
    return (value - jax.lax.stop_gradient(highest_advantage + value)) ** 2
