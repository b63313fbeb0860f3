"""Priors that ship with the package, each with a card that tells what it was trained on and how well it does.

`upslope reproduce shipped-prior` writes the three files of the one for CartPoles.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from upslope.errors import UpslopeError

if TYPE_CHECKING:
    from upslope.priors.prior import Prior

_FOLDER = Path(__file__).parent


class UnknownPriorError(UpslopeError):
    """No prior of this name ships."""


def load_prior(name: str) -> "Prior":
    """A prior by name, such as ``load_prior("cartpole")``.

    Raises:
        UnknownPriorError: there is none of this name.
    """
    from upslope.priors.prior import Prior  # only here: a simulator process asks for the path, and imports no JAX

    return Prior.load(prior_path(name))


def prior_path(name: str) -> Path:
    """Where the prior of this name lies: for wrappers in simulator processes, which need no JAX.

    Raises:
        UnknownPriorError: there is none of this name.
    """
    names = sorted(path.stem for path in _FOLDER.glob("*.safetensors"))
    if name not in names:
        raise UnknownPriorError(
            f"No prior {name!r} ships with upslope: choose one of {', '.join(names)}, "
            "or give the path of one of your own to Prior.load."
        )
    return _FOLDER / f"{name}.safetensors"


def card(name: str) -> str:
    """The card of the prior of this name, in Markdown.

    Raises:
        UnknownPriorError: there is none of this name.
    """
    return prior_path(name).with_suffix(".md").read_text(encoding="utf-8")
