"""The kinds of action that tasks have."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True)
class DiscreteActions:
    """The integers from 0 to ``count`` − 1.

    Attributes:
        count: the number of actions.
    """

    kind: ClassVar[str] = "discrete"

    count: int

    def zeros(self, *batch: int, xp: Any = np) -> Any:
        """Zero actions ``[*batch]``, as 32-bit integers in NumPy or jax.numpy (``xp``)."""
        return xp.zeros(batch, np.int32)


@dataclass(frozen=True)
class ContinuousActions:
    """Vectors of ``count`` numbers in [−1, 1].

    Attributes:
        count: the number of components of one action.
    """

    kind: ClassVar[str] = "continuous"

    count: int

    def zeros(self, *batch: int, xp: Any = np) -> Any:
        """Zero actions ``[*batch, count]``, in float32, as arrays of NumPy or jax.numpy (``xp``)."""
        return xp.zeros((*batch, self.count), np.float32)


Actions = DiscreteActions | ContinuousActions
