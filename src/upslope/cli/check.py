"""``upslope check``: checks the reward shaping of a user's environment."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg, subcommand

from upslope.checking.checking import check_shaping
from upslope.cli.places import call, find_function, is_place
from upslope.cli.prior_files import prior_file
from upslope.errors import UpslopeError
from upslope.priors.numpy_potential import NumpyPotential


@dataclass(frozen=True)
class Check:
    """Check that an environment's reward shaping is potential-based.

    The exit code is 1 if it is not, or if there were too few steps to tell.
    """

    factory: Annotated[Positional[str], arg(metavar="FACTORY")]
    """MODULE:FACTORY, a function without arguments that returns the shaped environment."""
    prior: Annotated[Positional[str], arg(metavar="PRIOR")]
    """File of the prior, or the name of a shipped one; or MODULE:FUNCTION for a potential of your own."""
    gamma: float | None = None
    """The learner's discount; the prior's by default."""
    steps: int = 2000
    """Number of steps to run."""
    seed: int = 0
    """Seed of everything random."""

    def __call__(self) -> None:
        is_function = is_place(self.prior) and not Path(self.prior).exists()
        potential: Any = find_function(self.prior) if is_function else NumpyPotential.load(prior_file(self.prior))
        gamma = self.gamma if self.gamma is not None else getattr(potential, "gamma", None)
        if gamma is None:
            raise UpslopeError(f"{self.prior} does not say its discount: give the learner's with --gamma.")
        report = check_shaping(call(self.factory), potential, gamma, steps=self.steps, seed=self.seed)
        print(report)
        if not report.ok:
            sys.exit(1)


def command(arguments: Sequence[str]) -> Any:
    """The command's type; it is the same for all arguments."""
    del arguments
    return Annotated[Check, subcommand("check")]
