"""Simulators that are installed on demand."""

import importlib
from typing import Any

from upslope.errors import UpslopeError


def gymnax() -> Any:
    """The module, if it is installed.

    Raises:
        UpslopeError: it isn't.
    """
    return _import("gymnax", "pip install 'upslope[families]' && pip install --no-deps gymnax")


def gymnasium_robotics() -> Any:
    """The module, if it is installed; its environments are registered.

    Raises:
        UpslopeError: it isn't.
    """
    return _import("gymnasium_robotics", "pip install 'upslope[families]'")


def minigrid() -> Any:
    """The module, if it is installed; its environments are registered.

    Raises:
        UpslopeError: it isn't.
    """
    return _import("minigrid", "pip install 'upslope[families]'")


def _import(name: str, command: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UpslopeError(f"This family needs the package {name}, which can't be imported: {command}") from error
