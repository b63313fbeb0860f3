"""Observations of a space: their shapes, and batches of them taken apart and put together."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from upslope.errors import UpslopeError


def check_shape(space: gym.Space, obs: Any, leading: tuple[int, ...] = (), name: str = "") -> None:
    """Whether an observation has the shape that its space says, and so each part of one with parts.

    Args:
        space: of one observation.
        obs: one observation, or a batch.
        leading: the leading axes of a batch.
        name: of the part, for the message.

    Raises:
        UpslopeError: another shape, or a missing part.
    """
    if isinstance(space, gym.spaces.Dict | gym.spaces.Tuple):
        parts = space.spaces.items() if isinstance(space, gym.spaces.Dict) else enumerate(space.spaces)
        for key, part in parts:
            check_shape(part, _part(obs, key), leading, f"{name}[{key!r}]")
    elif space.shape is not None and np.shape(obs) != (*leading, *space.shape):
        raise UpslopeError(
            f"The environment gave an observation{name} of shape {np.shape(obs)}, but its observation space says "
            f"{(*leading, *space.shape)}: mend the environment's observation_space, or what changes the observation's "
            "shape."
        )


def misfit(space: gym.Space, obs: Any) -> str:
    """What `check_shape` says of an observation; empty if it fits."""
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
    """As many observations out of a batch as it has, some of them again in the place of others."""
    if isinstance(batch, np.ndarray):
        return batch[rows]
    singles = split(space, batch, len(rows))
    return join(space, [singles[i] for i in rows])


def _part(obs: Any, key: Any) -> Any:
    try:
        return obs[key]
    except (KeyError, IndexError, TypeError) as error:
        raise UpslopeError(
            f"The environment gave an observation without the part {key!r} that its observation space has: "
            "mend the environment's observation_space, or what leaves the part out."
        ) from error
