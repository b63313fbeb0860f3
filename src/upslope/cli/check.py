"""``upslope check``: judges a shaped environment of the user's."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from upslope.checking.checking import check_shaping
from upslope.errors import UpslopeError
from upslope.priors.numpy_potential import NumpyPotential


@dataclass(frozen=True)
class Check:
    """Check that an environment's reward shaping is potential-based; exit code 1 if not, or if too little was seen."""

    factory: Positional[str]
    """MODULE:FACTORY, a function without arguments that returns the shaped environment."""
    prior: Positional[str]
    """The prior's file; or MODULE:FUNCTION for a potential of your own."""
    gamma: float | None = None
    """The learner's discount; the prior's by default."""
    steps: int = 2000
    """How many steps are played."""
    seed: int = 0
    """Of everything random."""

    def __call__(self) -> None:
        is_function = ":" in self.prior and not Path(self.prior).exists()
        potential: Any = find(self.prior) if is_function else NumpyPotential.load(self.prior)
        gamma = self.gamma if self.gamma is not None else getattr(potential, "gamma", None)
        if gamma is None:
            raise UpslopeError(f"{self.prior} does not say its discount: give the learner's with --gamma.")
        env = made(self.factory)
        report = check_shaping(env, potential, gamma, steps=self.steps, seed=self.seed)
        print(report)
        if not report.ok:
            sys.exit(1)


def find(place: str) -> Callable:
    """What stands at MODULE:NAME, looked for in the current folder too.

    Raises:
        UpslopeError: no such module, no such name in it, or nothing that can be called.
    """
    module, colon, name = place.partition(":")
    if not (module and colon and name):
        raise UpslopeError(f"{place!r} names no function: write MODULE:FUNCTION.")
    sys.path.insert(0, "")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise UpslopeError(f"{place} was not found ({error}): check the names, and the folder you are in.") from error
    finally:
        sys.path.remove("")
    if not callable(found):
        raise UpslopeError(f"{place} is {type(found).__name__}, but must be a function.")
    return found


def made(place: str) -> Any:
    """The environment of a factory at MODULE:FACTORY.

    Raises:
        UpslopeError: no such factory, or one that fails.
    """
    factory = find(place)
    try:
        return factory()
    except Exception as error:
        raise UpslopeError(
            f"{place} failed ({type(error).__name__}: {error}): it must run without arguments."
        ) from error
