"""Priors that ship with the package, each with a card: what it was trained on and how good it is.

`upslope reproduce shipped-prior` writes the three files of the prior for CartPoles.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from upslope.errors import UpslopeError

if TYPE_CHECKING:
    from upslope.priors.prior import Prior

_FOLDER = Path(__file__).parent


class UnknownPriorError(UpslopeError):
    """No prior of this name ships with the package."""


def load_prior(name: str) -> "Prior":
    """Loads a prior by name, such as ``load_prior("cartpole")``.

    Raises:
        UnknownPriorError: no prior has this name.
    """
    from upslope.priors.prior import Prior  # here, so that a simulator process that needs only the path imports no JAX

    return Prior.load(prior_path(name))


def prior_path(name: str) -> Path:
    """The path of the prior of this name: for wrappers in simulator processes, which need no JAX.

    Raises:
        UnknownPriorError: no prior has this name.
    """
    names = sorted(path.stem for path in _FOLDER.glob("*.safetensors"))
    if name not in names:
        raise UnknownPriorError(
            f"No prior {name!r} ships with upslope: choose one of {', '.join(names)}, "
            "or load one of your own with Prior.load(path)."
        )
    return _FOLDER / f"{name}.safetensors"


def card(name: str) -> str:
    """The card of the prior of this name, in Markdown.

    Raises:
        UnknownPriorError: no prior has this name.
    """
    return prior_path(name).with_suffix(".md").read_text(encoding="utf-8")
