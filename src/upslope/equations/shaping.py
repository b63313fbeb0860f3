"""Potential-based reward shaping: Def. 2.1 and Eq. 1, for numbers and for arrays of NumPy and of JAX.

One rule: F = d·Φ(s') − Φ(s), where d is the very factor that multiplies the bootstrap in the learner's TD target.
Imports no JAX: the wrappers in simulator processes use it too.
"""

from typing import Any, TypeAlias

from jaxtyping import Float

#: One number, or an array of either library.
Values: TypeAlias = Float[Any, "..."] | float


def shaping_reward(value: Values, discount: Values, next_value: Values) -> Any:
    """Def. 2.1: F(s, a, s') = d·Φ(s') − Φ(s).

    Args:
        value: Φ(s), in units of return.
        discount: d = γ·(1 − terminated): γ on ordinary and truncated steps, 0 on terminated ones.
        next_value: Φ(s') of the true successor (never of a reset observation).
    """
    return discount * next_value - value


def shaped_optimum(optimal_value: Values, value: Values) -> Any:
    """Eq. 1: Q*_{M'}(s, a) = Q*_M(s, a) − Φ(s), and V*_{M'}(s) = V*_M(s) − Φ(s).

    Args:
        optimal_value: V* ``[...]``, or Q* with its actions on the last axis ``[..., actions]``.
        value: Φ(s), of V*'s shape, or with a last axis of length one for Q*.
    """
    return optimal_value - value
