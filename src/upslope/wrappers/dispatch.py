"""`upslope.shape`: shapes the rewards of an environment of any of the three kinds that have a wrapper."""

import sys
from importlib import import_module
from typing import Any, NamedTuple

from upslope.errors import UpslopeError
from upslope.wrappers.abstract_shaping import with_shaping_arguments
from upslope.wrappers.terms import Number


class Kind(NamedTuple):
    """A kind of environment.

    Attributes:
        name: with its article.
        library: the module of its base class, which an environment of this kind has imported already.
        base: name of the base class.
        home: the module of its wrapper, ``PotentialShaping``.
    """

    name: str
    library: str
    base: str
    home: str

    def includes(self, env: Any) -> bool:
        base = getattr(sys.modules.get(self.library), self.base, None)
        return base is not None and isinstance(env, base)

    def check(self, env: Any) -> None:
        """Checks that an environment is of this kind.

        Raises:
            UpslopeError: it is not.
        """
        if _kind_of(env) is not self:
            raise UpslopeError(
                f"{type(env).__name__} is not {self.name}: use upslope.shape(env, potential, gamma), "
                "which chooses the wrapper that fits the environment."
            )


SINGLE = Kind("a single Gymnasium environment", "gymnasium", "Env", "upslope.wrappers.potential_shaping")
VECTOR = Kind("a Gymnasium vector environment", "gymnasium.vector", "VectorEnv", "upslope.wrappers.vector")
VEC_ENV = Kind("a VecEnv of Stable-Baselines3", "stable_baselines3.common.vec_env", "VecEnv", "upslope.wrappers.sb3")
KINDS = (SINGLE, VECTOR, VEC_ENV)


@with_shaping_arguments
def shape(env: Any, potential: Any, gamma: Number | Any, **settings: Any) -> Any:
    """Wraps an environment so that its rewards are R + F, with F = γ·Φ(s') − Φ(s) (Def. 2.1).

    Returns the wrapper for the kind of environment: `upslope.PotentialShaping`, or the class of the same name in
    `upslope.wrappers.vector` or `upslope.wrappers.sb3`. The settings are ``scale``, ``bias``, ``enabled``,
    ``anneal_steps`` and ``repeat``.
    """
    return import_module(_kind_of(env).home).PotentialShaping(env, potential, gamma, **settings)


def _kind_of(env: Any) -> Kind:
    for kind in KINDS:
        if kind.includes(env):
            return kind
    raise UpslopeError(
        f"{type(env).__name__} is not an environment that can be shaped: give {KINDS[0].name}, {KINDS[1].name} "
        f"or {KINDS[2].name}."
    )
