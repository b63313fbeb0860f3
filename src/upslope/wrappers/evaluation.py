"""Φ of observations as plain floats, whatever Φ is: a prior, or a function in numpy, JAX or torch."""

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from jaxtyping import Bool, Float

from upslope.errors import UpslopeError
from upslope.priors.numpy_potential import NumpyPotential
from upslope.wrappers.observations import check_shape, join, pick, split


class CallingForm(NamedTuple):
    """How a user's function wants to be called."""

    batched: bool
    tensor: bool


class Evaluator:
    """Evaluates Φ on observations of one space.

    A function that works on one observation is called on one at a time: whether it would take a batch can't be told
    for certain from outside. A function that works only with a leading batch axis is given one. Torch functions are
    given tensors, without gradients. How it wants to be called is found out on the first observation.
    """

    def __init__(self, potential: Any, space: gym.Space):
        """Takes Φ: a prior, the path of a saved one, or a function; and the space of one observation.

        Raises:
            UpslopeError: something that is no potential, or a prior for other observations.
        """
        self.potential: Any = resolve(potential)
        self._space = space
        self._shape = space.shape
        self._is_prior = isinstance(self.potential, NumpyPotential)
        self._form: CallingForm | None = None
        if hasattr(self.potential, "trained_on"):
            _check_space(self.potential.trained_on.observation_shape, space)

    def one(self, obs: Any) -> float:
        """Φ of one observation.

        Raises:
            UpslopeError: Φ fails, or is not one finite number; or the observation is of another shape than the space.
        """
        if self._shape is None or np.shape(obs) != self._shape:  # the usual case costs one comparison
            check_shape(self._space, obs)
        try:
            value = self.potential(obs) if self._is_prior else self._number(obs)
        except UpslopeError:
            raise
        except Exception as error:
            raise _failed(error, obs) from error
        if not math.isfinite(value):
            raise _not_finite(value, obs)
        return value

    def several(self, observations: Sequence[Any]) -> Float[np.ndarray, "n"]:
        """Φ of each of a list of single observations."""
        return np.asarray([self.one(obs) for obs in observations], np.float64)

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        """Φ of a batch of ``count`` observations, as vector environments give them.

        Raises:
            UpslopeError: see `one`.
        """
        check_shape(self._space, batch, (count,))
        return self._all(batch, count)

    def where(self, batch: Any, asked: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Φ of those of a batch that are asked for, and zero elsewhere: there it need not be defined.

        Raises:
            UpslopeError: see `one`.
        """
        count = len(asked)
        if asked.all():
            return self.many(batch, count)
        values = np.zeros(count)
        if asked.any():
            check_shape(self._space, batch, (count,))
            # One that is asked for stands in for the others: a compiled Φ then sees batches of one size only.
            rows = np.where(asked, np.arange(count), np.argmax(asked))
            values[asked] = self._all(pick(self._space, batch, rows), count)[asked]
        return values

    def _all(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        form = None if self._is_prior else self._form or self._find_form(split(self._space, batch, count)[0])
        if form is not None and not form.batched:
            return self.several(split(self._space, batch, count))
        try:
            values = self.potential.values(batch) if form is None else self._call(batch, count, form)
        except UpslopeError:
            raise
        except Exception as error:
            raise _failed(error, batch) from error
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise _not_finite(values[bad[0]], split(self._space, batch, count)[bad[0]])
        return values

    def _number(self, obs: Any) -> float:
        form = self._form or self._find_form(obs)
        return float(self._call(join(self._space, [obs]) if form.batched else obs, 1, form)[0])

    def _find_form(self, obs: Any) -> CallingForm:
        """The first way of calling Φ that gives one number for one observation."""
        torch = sys.modules.get("torch")
        if torch is not None and isinstance(self.potential, torch.nn.Module):
            forms = [CallingForm(False, True), CallingForm(True, True)]
        else:
            forms = [CallingForm(False, False), CallingForm(True, False)]
            forms += [CallingForm(False, True), CallingForm(True, True)] if torch is not None else []
        troubles = []
        for form in forms:
            try:
                self._call(join(self._space, [obs]) if form.batched else obs, 1, form)
            except Exception as error:
                troubles.append(error)
            else:
                self._form = form
                return form
        raise troubles[0] if isinstance(troubles[0], UpslopeError) else _failed(troubles[0], obs)

    def _call(self, inputs: Any, count: int, form: CallingForm) -> Float[np.ndarray, "n"]:
        result = _without_gradients(self.potential, inputs) if form.tensor else self.potential(inputs)
        if hasattr(result, "detach"):
            result = result.detach().cpu().numpy()
        try:
            values = np.asarray(result)
        except Exception:
            values = np.asarray(None)
        allowed = [(count,), (count, 1)] + ([] if form.batched else [()])
        if values.dtype.kind not in "fiu" or values.shape not in allowed:
            what = f"an array of shape {values.shape}" if values.dtype.kind in "fiu" else type(result).__name__
            raise UpslopeError(
                f"The potential returned {what} for {count} observation{'s' * (count > 1)}: "
                "return one number for one observation, or n numbers for a batch of n."
            )
        return values.reshape(count).astype(np.float64)


def resolve(potential: Any) -> Callable[[Any], Any]:
    """The callable behind a potential: paths are loaded, priors become numpy.

    Raises:
        UpslopeError: no potential, or a file that is no prior.
    """
    if isinstance(potential, str | Path):
        return NumpyPotential.load(potential)
    if hasattr(potential, "to_numpy") and hasattr(potential, "trained_on"):
        return potential.to_numpy()
    if not callable(potential):
        raise UpslopeError(
            f"{potential!r} is no potential: give a prior, the path of a saved one, or a function of one observation."
        )
    return potential


def recordable(potential: Any) -> Any:
    """A potential as a spec keeps it: paths as text, for JSON, and priors as plain numpy, compared by value."""
    if isinstance(potential, Path):
        return str(potential)
    return resolve(potential) if hasattr(potential, "to_numpy") else potential


def _check_space(shape: tuple[int, ...], space: gym.Space) -> None:
    if not isinstance(space, gym.spaces.Box) or space.shape != tuple(shape):
        raise UpslopeError(
            f"The prior is for observations of shape {tuple(shape)}, but the environment's observations are {space}: "
            "use a prior of this family, or a wrapper such as gymnasium.wrappers.FlattenObservation below the shaping."
        )


def _without_gradients(potential: Callable, inputs: Any) -> Any:
    torch = sys.modules["torch"]
    parameters = getattr(potential, "parameters", lambda: iter(()))()
    like = next(iter(parameters), torch.zeros(()))

    def tensor(leaf: Any) -> Any:
        if isinstance(leaf, dict):
            return {name: tensor(part) for name, part in leaf.items()}
        made = torch.as_tensor(np.asarray(leaf), device=like.device)
        return made.to(like.dtype) if made.is_floating_point() else made

    with torch.no_grad():
        return potential(tensor(inputs))


def _failed(error: Exception, obs: Any) -> UpslopeError:
    return UpslopeError(
        f"The potential failed on an observation of shape {np.shape(obs)} ({type(error).__name__}: {error}): "
        "write it for one observation, or for a batch with a leading axis."
    )


def _not_finite(value: float, obs: Any) -> UpslopeError:
    return UpslopeError(f"The potential is {value} at the observation {obs}: make it finite everywhere.")
