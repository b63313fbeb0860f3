"""Maps as people write them: a line for each row, with S, G, # (obstacle), T (trap) and . (free)."""

import jax.numpy as jnp
import numpy as np

from upslope.envs.grid import GridParams, check_settings
from upslope.errors import UpslopeError

START, GOAL, OBSTACLE, TRAP, FREE = "SG#T."


def read_map(text: str, *, trap_penalty: float = 1.0, slip: float = 0.0, max_steps: int = 50) -> GridParams:
    """The map that a text shows.

    Args:
        text: one line for each row; spaces around lines do not count.
        trap_penalty: what entering a trap costs.
        slip: probability that a move goes to one of its two sides instead.
        max_steps: truncation.

    Raises:
        UpslopeError: rows of different lengths, an unknown character, not one start and one goal, or a penalty or a
            probability that is none.
    """
    rows = [line.strip() for line in text.strip().splitlines()]
    if len({len(row) for row in rows}) != 1:
        raise UpslopeError(f"The map's rows have {sorted({len(row) for row in rows})} cells: give all the same number.")
    board = np.array([list(row) for row in rows])
    if unknown := sorted(set(board.ravel()) - {START, GOAL, OBSTACLE, TRAP, FREE}):
        raise UpslopeError(f"The map has {''.join(unknown)!r} in it: write it with S, G, # (obstacle), T (trap) and .")
    for name, mark in (("start", START), ("goal", GOAL)):
        if np.sum(board == mark) != 1:
            raise UpslopeError(f"The map has {np.sum(board == mark)} cells with {mark}: give it one {name}.")
    check_settings(slip, trap_penalty)
    return GridParams(
        obstacles=jnp.asarray(board == OBSTACLE),
        traps=jnp.asarray(board == TRAP),
        start=jnp.asarray(np.flatnonzero(board == START)[0], jnp.int32),
        goal=jnp.asarray(np.flatnonzero(board == GOAL)[0], jnp.int32),
        trap_penalty=jnp.asarray(trap_penalty, jnp.float32),
        slip=jnp.asarray(slip, jnp.float32),
        max_steps_in_episode=max_steps,
    )


def write_map(params: GridParams) -> str:
    """One map as text: what `read_map` reads, penalty and slipping apart."""
    board = np.where(params.obstacles, OBSTACLE, np.where(params.traps, TRAP, FREE))
    board.flat[int(params.start)], board.flat[int(params.goal)] = START, GOAL
    return "\n".join("".join(row) for row in board)
