"""Observations of a space: checks of their shapes, and batches of them split and joined."""

from collections.abc import Iterable, Sequence
from functools import singledispatch
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from upslope.errors import UpslopeError


def check_shape(space: gym.Space, obs: Any, leading: tuple[int, ...] = (), name: str = "") -> None:
    """Checks that an observation, or each of its parts, has the shape that its space declares.

    Args:
        space: of one observation.
        obs: one observation, or a batch.
        leading: the leading axes of a batch.
        name: of the part, for the message.

    Raises:
        UpslopeError: it has another shape, or a part is missing.
    """
    for key, part in _parts(space):
        check_shape(part, _part(obs, key), leading, f"{name}[{key!r}]")
    if space.shape is not None and np.shape(obs) != (*leading, *space.shape):
        raise UpslopeError(
            f"The environment gave an observation{name} of shape {np.shape(obs)}, but its observation space says "
            f"{(*leading, *space.shape)}: correct the environment's observation_space, or the wrapper that changes the "
            "observation's shape."
        )


def misfit(space: gym.Space, obs: Any) -> str:
    """The message of `check_shape` about an observation; empty if its shape is right."""
    try:
        check_shape(space, obs)
    except UpslopeError as error:
        return str(error)
    return ""


def join(space: gym.Space, observations: Sequence[Any]) -> Any:
    """A batch of single observations."""
    empty: Any = create_empty_array(space, len(observations))
    return concatenate(space, observations, empty)


def split(space: gym.Space, batch: Any, count: int) -> list[Any]:
    """The single observations of a batch."""
    if isinstance(batch, np.ndarray):
        return [batch[i] for i in range(count)]
    return list(iterate(batch_space(space, count), batch))


def pick(space: gym.Space, batch: Any, rows: np.ndarray) -> Any:
    """A batch of the same size, with the given rows of another one; rows may repeat."""
    if isinstance(batch, np.ndarray):
        return batch[rows]
    singles = split(space, batch, len(rows))
    return join(space, [singles[i] for i in rows])


@singledispatch
def _parts(space: gym.Space) -> Iterable[tuple[Any, gym.Space]]:
    """The spaces of an observation's parts, by key."""
    return ()


@_parts.register(gym.spaces.Dict)
def _(space: Any) -> Iterable[tuple[Any, gym.Space]]:
    return space.spaces.items()


@_parts.register(gym.spaces.Tuple)
def _(space: Any) -> Iterable[tuple[Any, gym.Space]]:
    return enumerate(space.spaces)


def _part(obs: Any, key: Any) -> Any:
    try:
        return obs[key]
    except (KeyError, IndexError, TypeError) as error:
        raise UpslopeError(
            f"The environment gave an observation without the part {key!r} that its observation space has: "
            "correct the environment's observation_space, or the wrapper that drops the part."
        ) from error
