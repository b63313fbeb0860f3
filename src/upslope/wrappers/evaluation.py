"""Φ of observations as plain floats, for potentials of every kind, with clear errors where Φ fails."""

from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Bool, Float

from upslope.errors import UpslopeError
from upslope.priors.numpy_potential import NumpyPotential
from upslope.wrappers.calling import call_of
from upslope.wrappers.observations import check_shape, pick, split


class Evaluator:
    """Evaluates Φ on observations of one space.

    Attributes:
        potential: Φ; a prior as a `NumpyPotential`.
    """

    def __init__(self, potential: Any, space: gym.Space):
        """Takes Φ (a prior, the path of a saved one, or a function) and the space of one observation.

        Raises:
            UpslopeError: not a potential, or a prior for other observations.
        """
        self.potential: Any = resolve(potential)
        self._space, self._shape = space, space.shape
        self._call = call_of(self.potential, space)

    def one(self, obs: Any) -> float:
        """Φ of one observation.

        Raises:
            UpslopeError: Φ fails or is not one finite number, or the observation has another shape than the space.
        """
        # The usual case costs one comparison.
        if self._shape is None or getattr(obs, "shape", None) != self._shape:
            check_shape(self._space, obs)
        try:
            value = self._call.one(obs)
        except UpslopeError:
            raise
        except Exception as error:
            raise _failed(error, np.shape(obs)) from error
        if not isfinite(value):
            raise _not_finite(value, obs)
        return value

    def several(self, observations: Sequence[Any]) -> Float[np.ndarray, "n"]:
        """Φ of each of a list of single observations."""
        return np.asarray([self.one(obs) for obs in observations], np.float64)

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        """Φ of a batch of ``count`` observations, in the form that vector environments use.

        Raises:
            UpslopeError: see `one`.
        """
        check_shape(self._space, batch, (count,))
        try:
            values = self._call.many(batch, count)
        except UpslopeError:
            raise
        except Exception as error:
            raise _failed(error, self._shape) from error
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise _not_finite(values[bad[0]], split(self._space, batch, count)[bad[0]])
        return values

    def where(self, batch: Any, needed: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Φ where it is needed, and zero elsewhere: there it need not be defined.

        Raises:
            UpslopeError: see `one`.
        """
        count = len(needed)
        if needed.all():
            return self.many(batch, count)
        values = np.zeros(count)
        if needed.any():
            check_shape(self._space, batch, (count,))
            # A needed observation replaces the others: a compiled Φ then sees batches of one size only.
            rows = np.where(needed, np.arange(count), np.argmax(needed))
            values[needed] = self.many(pick(self._space, batch, rows), count)[needed]
        return values


def resolve(potential: Any) -> Callable[[Any], Any]:
    """The callable behind a potential: loads paths, and turns priors into plain NumPy.

    Raises:
        UpslopeError: not a potential, or a file that is not a prior.
    """
    if isinstance(potential, str | Path):
        return NumpyPotential.load(potential)
    # A prior brings its own NumPy form: its class is not imported here, for it needs JAX.
    potential = getattr(potential, "to_numpy", lambda: potential)()
    if not callable(potential):
        raise UpslopeError(
            f"{potential!r} is not a potential: give a prior, the path of one, or a function of one observation."
        )
    return potential


def recordable(potential: Any) -> Any:
    """A potential as a spec keeps it: paths as text, for JSON, and priors in plain NumPy, compared by value."""
    return str(potential) if isinstance(potential, str | Path) else resolve(potential)


def _failed(error: Exception, shape: tuple[int, ...] | None) -> UpslopeError:
    return UpslopeError(
        f"The potential failed on an observation of shape {shape} ({type(error).__name__}: {error}): "
        "write it for one observation, or for a batch with a leading axis."
    )


def _not_finite(value: float, obs: Any) -> UpslopeError:
    return UpslopeError(f"The potential is {value} at the observation {obs}: make it finite everywhere.")
