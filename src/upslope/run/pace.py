"""How many steps go into one chunk."""

import math


class Pace:
    """Chunks of about a second, so that the loop looks up often enough to save, and to stop when asked to.

    Args:
        seconds: that a chunk should take; infinite for chunks of any length.
    """

    def __init__(self, seconds: float):
        self._seconds = seconds
        self._longest = 1 if math.isfinite(seconds) else None

    def steps(self, wanted: int) -> int:
        """How many of the wanted steps to take now."""
        return wanted if self._longest is None else min(wanted, self._longest)

    def took(self, steps: int, seconds: float) -> None:
        """Learns from a chunk; one of no steps teaches nothing."""
        if self._longest is not None and steps:
            fitting = int(steps * self._seconds / max(seconds, 1e-9))
            self._longest = max(1, min(fitting, 8 * self._longest))
