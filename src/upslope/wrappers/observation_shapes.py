"""Whether an observation has the shape that its space declares."""

from typing import Any

import gymnasium as gym
import numpy as np


def mismatch(obs: Any, space: gym.Space) -> str:
    """In words, where an observation's shape is not that of its space; empty if it is.

    Spaces without a fixed shape, such as sequences, are let pass.
    """
    if isinstance(space, gym.spaces.Dict) and isinstance(obs, dict):
        return next(filter(None, (mismatch(obs[key], part) for key, part in space.items() if key in obs)), "")
    if isinstance(space, gym.spaces.Tuple) and isinstance(obs, tuple):
        return next(filter(None, (mismatch(*both) for both in zip(obs, space, strict=False))), "")
    if isinstance(space, gym.spaces.Box) and np.shape(obs) != space.shape:
        return f"an observation has shape {np.shape(obs)}, but its space says {space.shape}."
    return ""
