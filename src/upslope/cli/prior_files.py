"""Priors on the command line: files, and the priors that ship with the package by name."""

from pathlib import Path

from upslope.errors import UpslopeError
from upslope.priors.pretrained import UnknownPriorError, prior_path


def prior_file(prior: str) -> Path:
    """The file of a prior.

    Args:
        prior: a path, or the name of a prior that ships with the package.

    Raises:
        UpslopeError: there is no such file, and no such name.
    """
    path = Path(prior)
    if path.is_file():
        return path
    try:
        return prior_path(prior)
    except UnknownPriorError as error:
        raise UpslopeError(
            f"There is no prior {prior!r}: give the file that `upslope meta-train` wrote, "
            "or the name of a prior that ships with upslope, such as cartpole."
        ) from error
