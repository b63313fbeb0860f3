"""Ways to call a potential: a prior, or a function of one observation or of a batch, in NumPy, JAX or torch."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import Float

from upslope.errors import UpslopeError
from upslope.priors.numpy_potential import NumpyPotential
from upslope.wrappers.observations import join, split


class AbstractCall(ABC):
    """Evaluates a potential on one observation and on a batch, however it wants to be called."""

    @abstractmethod
    def one(self, obs: Any) -> float:
        """Φ of one observation."""

    @abstractmethod
    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        """Φ of a batch of ``count`` observations."""


class PriorCall(AbstractCall):
    """A prior evaluates single observations and batches alike."""

    def __init__(self, potential: NumpyPotential):
        self._potential = potential

    def one(self, obs: Any) -> float:
        return self._potential(obs)

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        return self._potential.values(batch)


class SingleCall(AbstractCall):
    """A function of one observation."""

    def __init__(self, function: Callable, space: gym.Space):
        self._function, self._space = function, space

    def one(self, obs: Any) -> float:
        return float(_numbers(self._function(obs), 1, ((), (1,), (1, 1)))[0])

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        return np.asarray([self.one(obs) for obs in split(self._space, batch, count)], np.float64)


class BatchCall(AbstractCall):
    """A function that needs a leading batch axis."""

    def __init__(self, function: Callable, space: gym.Space):
        self._function, self._space = function, space

    def one(self, obs: Any) -> float:
        return float(self.many(join(self._space, [obs]), 1)[0])

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        return _numbers(self._function(batch), count, ((count,), (count, 1)))


class FirstCall(AbstractCall):
    """Of several calls, the first that works on the first observation."""

    def __init__(self, candidates: Iterable[AbstractCall], space: gym.Space):
        self._candidates, self._space = tuple(candidates), space
        self._choice: AbstractCall | None = None

    def one(self, obs: Any) -> float:
        return (self._choice or self._choose(obs)).one(obs)

    def many(self, batch: Any, count: int) -> Float[np.ndarray, "n"]:
        return (self._choice or self._choose(split(self._space, batch, count)[0])).many(batch, count)

    def _choose(self, obs: Any) -> AbstractCall:
        errors = []
        for candidate in self._candidates:
            try:
                candidate.one(obs)
            except Exception as error:
                errors.append(error)
            else:
                self._choice = candidate
                return candidate
        raise errors[0]


class TensorFunction:
    """A torch function that is given tensors, like its parameters, and computes no gradients."""

    def __init__(self, function: Callable):
        self._function = function

    def __call__(self, inputs: Any) -> Any:
        torch = sys.modules["torch"]
        parameters = getattr(self._function, "parameters", lambda: iter(()))()
        like = next(iter(parameters), torch.zeros(()))

        def tensor(leaf: Any) -> Any:
            if isinstance(leaf, dict):
                return {name: tensor(part) for name, part in leaf.items()}
            result = torch.as_tensor(np.asarray(leaf), device=like.device)
            return result.to(like.dtype) if result.is_floating_point() else result

        with torch.no_grad():
            return self._function(tensor(inputs))


def call_of(potential: Callable, space: gym.Space) -> AbstractCall:
    """How to call a potential on observations of a space; a function shows it on the first observation.

    A function that works on one observation is called on one at a time: whether it would take a batch, too, can't be
    known for certain from outside. Only a function that needs a leading batch axis is given one.

    Raises:
        UpslopeError: a prior for other observations.
    """
    if isinstance(potential, NumpyPotential):
        _check_space(potential.trained_on.observation_shape, space)
        return PriorCall(potential)
    # A function can be one of torch only if torch has been imported.
    torch = sys.modules.get("torch")
    functions = [] if torch is not None and isinstance(potential, torch.nn.Module) else [potential]
    functions += [] if torch is None else [TensorFunction(potential)]
    return FirstCall([call(function, space) for function in functions for call in (SingleCall, BatchCall)], space)


def _check_space(shape: tuple[int, ...], space: gym.Space) -> None:
    if not isinstance(space, gym.spaces.Box) or space.shape != tuple(shape):
        raise UpslopeError(
            f"The prior is for observations of shape {tuple(shape)}, but the environment's observations are {space}: "
            "use a prior of this family, or a wrapper such as gymnasium.wrappers.FlattenObservation inside the shaping."
        )


def _numbers(result: Any, count: int, shapes: tuple[tuple[int, ...], ...]) -> Float[np.ndarray, "n"]:
    """What a function returned, as ``count`` numbers.

    Raises:
        UpslopeError: it returned something else.
    """
    try:
        values = np.asarray(result.detach().cpu() if hasattr(result, "detach") else result)
    except Exception:
        values = np.asarray(None)
    is_number = values.dtype.kind in "fiu"
    if not is_number or values.shape not in shapes:
        raise UpslopeError(
            f"The potential returned {f'an array of shape {values.shape}' if is_number else type(result).__name__} "
            f"for {count} observation{'s' * (count > 1)}: "
            "return one number for one observation, or n numbers for a batch of n."
        )
    return values.reshape(count).astype(np.float64)
