"""A first look at the arguments: the names that decide which options a command has."""

from collections.abc import Collection, Sequence
from typing import Annotated, Any

from tyro.conf import arg

from upslope.errors import UpslopeError


def first_name(arguments: Sequence[str], names: Collection[str], default: str) -> str:
    """The name given as the command's positional argument.

    Args:
        arguments: of the command.
        names: the known ones. After options, only these and names with a colon differ from the options' values.
        default: if there is none.
    """
    if arguments and not arguments[0].startswith("-"):
        return arguments[0]
    return next((one for one in arguments if one in names or (":" in one and not one.startswith("-"))), default)


def option(arguments: Sequence[str], name: str, default: str) -> str:
    """The value given as ``--name VALUE`` or ``--name=VALUE``."""
    value = default
    for index, argument in enumerate(arguments):
        if argument == f"--{name}":
            value = next(iter(arguments[index + 1 :]), default)
        elif argument.startswith(f"--{name}="):
            value = argument.partition("=")[2]
    return value


def default(settings: Any) -> Any:
    """The type of some settings, with these as the defaults on the command line."""
    return Annotated[type(settings), arg(default=settings)]


def check_first(command: str, name: str, was_found: bool) -> None:
    """Whether the first look found the name that counts; a value such as ``--out grid`` can hide it.

    Raises:
        UpslopeError: it did not.
    """
    if not was_found:
        raise UpslopeError(f"Write {name} directly after the command: `upslope {command} {name} ...`.")
