"""Objects of the user's own, named as MODULE:NAME."""

import sys
from importlib import import_module
from typing import Any

from upslope.errors import UpslopeError


def is_place(text: str) -> bool:
    """Whether a text looks like MODULE:NAME."""
    return ":" in text


def find(place: str) -> Any:
    """The object at MODULE:NAME, imported from the current folder or from any installed package.

    Raises:
        UpslopeError: no such module, or no such name in it.
    """
    module, colon, name = place.partition(":")
    if not (module and colon and name):
        raise UpslopeError(f"{place!r} does not name anything to import: write MODULE:NAME.")
    sys.path.insert(0, "")
    try:
        return getattr(import_module(module), name)
    except Exception as error:
        raise UpslopeError(
            f"{place} can't be imported ({type(error).__name__}: {error}): check the names, and the folder you are in."
        ) from error
    finally:
        sys.path.remove("")


def find_function(place: str) -> Any:
    """The function at MODULE:NAME.

    Raises:
        UpslopeError: see `find`; or it can't be called.
    """
    function = find(place)
    if not callable(function):
        raise UpslopeError(f"{place} is {type(function).__name__}, but must be a function.")
    return function


def call(place: str) -> Any:
    """What the function at MODULE:NAME returns without arguments.

    Raises:
        UpslopeError: see `find_function`; or it fails.
    """
    function = find_function(place)
    try:
        return function()
    except Exception as error:
        raise UpslopeError(
            f"{place} failed ({type(error).__name__}: {error}): it must run without arguments."
        ) from error
