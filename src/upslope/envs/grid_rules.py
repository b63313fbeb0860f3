"""The rules of grid games, for arrays of NumPy and of JAX. Needs no JAX.

Compiled games and games on the host therefore share their rules, and simulator processes load no JAX.
"""

import math
from types import ModuleType
from typing import Any, NamedTuple

from jaxtyping import Bool, Float, Int

from upslope.errors import UpslopeError

UP, DOWN, LEFT, RIGHT = range(4)

#: Channels of an observation; only games with traps have the last one.
START, GOAL, POSITION, OBSTACLES, TRAPS = range(5)

_ROW_STEPS = (-1, 1, 0, 0)
_COLUMN_STEPS = (0, 0, -1, 1)

#: Directions in which a move can go: as intended, or to either side if it slips.
SIDEWAYS = ((UP, LEFT, RIGHT), (DOWN, LEFT, RIGHT), (LEFT, UP, DOWN), (RIGHT, UP, DOWN))


class Outcomes(NamedTuple):
    """The dynamics as tables: the outcomes of every action in every cell.

    Goals, traps and obstacles lead to themselves, without reward, terminated.

    Attributes:
        successors: s' ``[cells, actions, outcomes]``; one outcome, or three where moves slip.
        probabilities: of each outcome.
        rewards: R(s, a, s').
        terminated: whether s' ends the episode.
        acting: cells in which the agent can act ``[cells]``.
    """

    successors: Int[Any, "cells actions outcomes"]
    probabilities: Float[Any, "cells actions outcomes"]
    rewards: Float[Any, "cells actions outcomes"]
    terminated: Bool[Any, "cells actions outcomes"]
    acting: Bool[Any, "cells"]


def destination(xp: ModuleType, obstacles: Bool[Any, "height width"], cell: Any, direction: Any) -> Any:
    """The cell after a move that did not slip; cells and directions may have any shapes that broadcast."""
    height, width = obstacles.shape
    row = cell // width + xp.asarray(_ROW_STEPS)[direction]
    column = cell % width + xp.asarray(_COLUMN_STEPS)[direction]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    there = xp.where(inside, row * width + column, cell)
    return xp.where(obstacles.ravel()[there], cell, there)


def arrival(xp: ModuleType, params: Any, cell: Int[Any, "*cells"]) -> tuple[Float[Any, "*cells"], Bool[Any, "*cells"]]:
    """The reward for entering cells of one map, and whether that ends the episode."""
    at_goal, trapped = cell == params.goal, params.traps.ravel()[cell]
    return xp.where(at_goal, 1.0, xp.where(trapped, -params.trap_penalty, 0.0)), at_goal | trapped


def chances(xp: ModuleType, slip: Any) -> Float[Any, "3"]:
    """Probabilities of going as intended, and to either side."""
    return xp.stack([1 - slip, slip / 2, slip / 2])


def outcomes(xp: ModuleType, params: Any, *, slippery: bool) -> Outcomes:
    """The dynamics of one map as tables."""
    cells = xp.arange(params.obstacles.size)
    ways = xp.asarray(SIDEWAYS)[:, : 3 if slippery else 1]
    successors = destination(xp, params.obstacles, cells[:, None, None], ways)
    probabilities = chances(xp, params.slip) if slippery else xp.ones(1)
    rewards, terminated = arrival(xp, params, successors)
    idle = (cells == params.goal) | (params.obstacles | params.traps).ravel()
    stuck = idle[:, None, None]
    return Outcomes(
        xp.where(stuck, cells[:, None, None], successors),
        xp.broadcast_to(probabilities, successors.shape),
        xp.where(stuck, 0.0, rewards),
        stuck | terminated,
        ~idle,
    )


def observation(xp: ModuleType, params: Any, cell: Any, *, traps: bool) -> Float[Any, "cells channels"]:
    """The observation in a cell: channels of zeros and ones."""
    cells = xp.arange(params.obstacles.size)
    layers = [cells == where for where in (params.start, params.goal, cell)] + [params.obstacles.ravel()]
    if traps:
        layers.append(params.traps.ravel())
    # Floats before they are stacked: JAX on CPUs takes five times as long to stack truth values.
    return xp.stack([layer.astype("float32") for layer in layers], axis=-1)


def check_settings(slip: float, trap_penalty: float) -> None:
    """Checks settings that all maps share.

    Raises:
        UpslopeError: ``slip`` is not a probability below 1, or the penalty is negative or not finite.
    """
    if not 0 <= slip < 1:
        raise UpslopeError(f"slip is {slip}, but it is a probability below 1: give one such as 0.2.")
    if not (math.isfinite(trap_penalty) and trap_penalty >= 0):
        raise UpslopeError(f"trap_penalty is {trap_penalty}, but traps cost something: give 0 or a positive number.")
