"""What the three shaping wrappers have in common: their arguments, and what they say about their settings."""

from collections.abc import Callable
from inspect import cleandoc
from typing import Any, TypeVar

from upslope.wrappers.terms import Terms

Function = TypeVar("Function", bound=Callable[..., Any])

_ARGUMENTS = """

Args:
    env: the environment: a Gymnasium environment, a Gymnasium vector environment (its ``metadata`` must hold its
        ``autoreset_mode``), or a VecEnv of Stable-Baselines3.
    potential: Φ: a prior, the path of a saved one, or a function of one observation (NumPy, JAX or torch; with a
        leading batch axis if it needs one). It must not change during training: for a potential that does, shape where
        batches are drawn (`upslope.wrappers.sb3.ShapedReplayBuffer`).
    gamma: γ of one step, the learner's own. If a step repeats its action k times, this is γ of one action to the
        power of k.
    scale: factor of Φ.
    bias: added to the scaled Φ, in units of return. Both change Q's initial values, and so how a deep learner explores.
    enabled: whether to shape at all; the attribute of this name switches it later, from the next reset on.
    anneal_steps: number of steps (of each environment) over which the weight of the shaping falls linearly to zero;
        None keeps it at one.
    repeat: number of times that a step repeats its action (frame-skip). Only the check of ``gamma`` against the prior's
        uses it.

Raises:
    UpslopeError: the environment is of another kind, the potential is not a potential, or the prior was trained for
        other observations or another γ.
"""


def with_shaping_arguments(function: Function) -> Function:
    """Appends the documentation of the arguments, which all wrappers share, to a docstring."""
    function.__doc__ = cleandoc(function.__doc__ or "") + _ARGUMENTS
    return function


class AbstractShaping:
    """A wrapper that adds F to the rewards.

    Attributes:
        enabled: the switch. It takes effect when the next episode begins, so that F telescopes over every episode.
            Either setting keeps the optimal policies, but values learned under one differ from the other's by Φ.
    """

    enabled: bool
    _terms: Terms

    @property
    def gamma(self) -> float:
        """γ that F is computed with; the learner must use the same."""
        return self._terms.gamma

    @property
    def invariance(self) -> str:
        """Whether these settings keep the optimal policies, in a sentence."""
        return self._terms.invariance
