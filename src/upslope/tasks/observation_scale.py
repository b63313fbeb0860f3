"""Factors that scale observations to the order of one, from the bounds of their space."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Shaped

from upslope.errors import UpslopeError

#: The largest bounds that are used, by the number of axes (images have bytes). Larger ones say little about typical
#: values.
_LARGEST = {1: 100.0, 3: 255.0}


def scale_of(
    low: Shaped[np.ndarray, "*obs"], high: Shaped[np.ndarray, "*obs"], given: Sequence[float] | None
) -> tuple[float, ...]:
    """One factor for each number of a vector, or for each channel of an image ``[height, width, channels]``.

    Args:
        low: smallest values.
        high: largest values.
        given: the factors to use. If None: one over the bound if that is finite and small, otherwise 1.

    Raises:
        UpslopeError: there are too few or too many factors, or some are not finite.
    """
    bound = np.maximum(np.abs(low), np.abs(high)).astype(np.float64)
    per_channel = bound.reshape(-1, bound.shape[-1]).max(axis=0)
    if given is None:
        largest = _LARGEST[bound.ndim]
        return tuple(float(1 / size) if 0 < size <= largest else 1.0 for size in per_channel)
    if len(given) != len(per_channel) or not np.all(np.isfinite(given)):
        raise UpslopeError(f"observation_scale has {len(given)} numbers: give {len(per_channel)} finite ones.")
    return tuple(float(factor) for factor in given)
