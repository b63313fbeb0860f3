"""Maps as text: one line per row, with S, G, # (obstacle), T (trap) and . (free). Needs no JAX."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from upslope.envs.grid_rules import check_settings
from upslope.errors import UpslopeError

START, GOAL, OBSTACLE, TRAP, FREE = "SG#T."


class Board(NamedTuple):
    """One map in NumPy; see `upslope.envs.grid.GridParams`."""

    obstacles: Bool[np.ndarray, "height width"]
    traps: Bool[np.ndarray, "height width"]
    start: np.int32
    goal: np.int32
    trap_penalty: np.float32
    slip: np.float32


def read_board(text: str, *, trap_penalty: float = 1.0, slip: float = 0.0) -> Board:
    """Reads a map from text.

    Args:
        text: one line per row; spaces around lines do not count.
        trap_penalty: cost of entering a trap.
        slip: probability that a move goes to one of its two sides instead.

    Raises:
        UpslopeError: rows of different lengths, an unknown character, not exactly one start and one goal, or a penalty
            or a probability that is out of range.
    """
    rows = [line.strip() for line in text.strip().splitlines()]
    if len({len(row) for row in rows}) != 1:
        raise UpslopeError(f"The map's rows have {sorted({len(row) for row in rows})} cells: give all the same number.")
    board = np.array([list(row) for row in rows])
    if unknown := sorted(set(board.ravel()) - {START, GOAL, OBSTACLE, TRAP, FREE}):
        raise UpslopeError(f"The map contains {''.join(unknown)!r}: write it with S, G, # (obstacle), T (trap) and .")
    for name, mark in (("start", START), ("goal", GOAL)):
        if np.sum(board == mark) != 1:
            raise UpslopeError(f"The map has {np.sum(board == mark)} cells with {mark}: give it one {name}.")
    check_settings(slip, trap_penalty)
    return Board(
        obstacles=board == OBSTACLE,
        traps=board == TRAP,
        start=np.int32(np.flatnonzero(board == START)[0]),
        goal=np.int32(np.flatnonzero(board == GOAL)[0]),
        trap_penalty=np.float32(trap_penalty),
        slip=np.float32(slip),
    )


def write_map(params: Any) -> str:
    """Writes the map of a task or a `Board` as text for `read_board`, without its penalty and its slipping."""
    board = np.where(params.obstacles, OBSTACLE, np.where(params.traps, TRAP, FREE))
    board.flat[int(params.start)], board.flat[int(params.goal)] = START, GOAL
    return "\n".join("".join(row) for row in board)
