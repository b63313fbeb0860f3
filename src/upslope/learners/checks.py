"""Checks of settings."""

from typing import Any

from upslope.errors import UpslopeError


def check_counts(settings: Any, *names: str) -> None:
    """Checks that these settings, which count something, are at least 1.

    Raises:
        UpslopeError: one is below 1.
    """
    for name in names:
        if getattr(settings, name) < 1:
            raise UpslopeError(f"{name} is {getattr(settings, name)}, but it counts something: give at least 1.")


def check_shares(**shares: float) -> None:
    """Checks that these numbers are shares.

    Raises:
        UpslopeError: one is not between 0 and 1.
    """
    for name, share in shares.items():
        if not 0 <= share <= 1:
            raise UpslopeError(f"{name} is {share}, but it is a share: give a number from 0 to 1.")
