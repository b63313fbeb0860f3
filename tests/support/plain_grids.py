"""Grid games in plain Python: maps as text, explicit moves, distances by breadth-first search."""

from collections import deque

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from upslope.envs.grid import GridParams

#: Row and column steps of up, down, left and right.
STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))
SIDES = {0: (2, 3), 1: (2, 3), 2: (0, 1), 3: (0, 1)}


@eqx.filter_jit
def _draw(family, key, count):
    return family.sample_many(key, count)


def draw(family, count, seed=0) -> GridParams:
    """Maps of a family, stacked, as numpy arrays."""
    return jax.tree.map(np.asarray, _draw(family, jax.random.key(seed), count))


def pick(maps, index):
    """One map of a stack."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[index]), maps)


def as_board(params: GridParams) -> list[list[str]]:
    """The map as rows of characters; the start counts as free."""
    obstacles, traps = np.asarray(params.obstacles), np.asarray(params.traps)
    board = [
        ["#" if wall else "T" if trap else "." for wall, trap in zip(*rows, strict=True)]
        for rows in zip(obstacles, traps, strict=True)
    ]
    row, column = divmod(int(params.goal), len(board[0]))
    board[row][column] = "G"
    return board


def neighbour(board, row, column, action):
    """Where a move leads: the next cell, or the same one at the border or an obstacle."""
    down, right = STEPS[action]
    there = row + down, column + right
    if not (0 <= there[0] < len(board) and 0 <= there[1] < len(board[0])):
        return row, column
    return (row, column) if board[there[0]][there[1]] == "#" else there


def plain_outcomes(board, row, column, action, *, slip=0.0, penalty=1.0):
    """The outcomes of an action: a dictionary from (row, column) to (probability, reward, terminated)."""
    ways = [(1 - slip, action), *((slip / 2, side) for side in SIDES[action])]
    result = {}
    for chance, way in ways:
        there = neighbour(board, row, column, way)
        thing = board[there[0]][there[1]]
        reward = {"G": 1.0, "T": -penalty}.get(thing, 0.0)
        before = result.get(there, (0.0,))[0]
        result[there] = (before + chance, reward, thing in "GT")
    return {there: outcome for there, outcome in result.items() if outcome[0] > 0}


def distances(board) -> np.ndarray:
    """Steps to the goal by breadth-first search, never through traps; −1 where the goal is unreachable."""
    result = np.full((len(board), len(board[0])), -1)
    goal = next((r, c) for r, row in enumerate(board) for c, thing in enumerate(row) if thing == "G")
    result[goal] = 0
    waiting = deque([goal])
    while waiting:
        row, column = waiting.popleft()
        for action in range(4):
            there = neighbour(board, row, column, action)
            if result[there] < 0 and board[there[0]][there[1]] == ".":
                result[there] = result[row, column] + 1
                waiting.append(there)
    return result
