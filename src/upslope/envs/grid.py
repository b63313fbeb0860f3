"""Grid games (Sec. 5.2): maps of any size with a start, a goal, obstacles, and if wanted traps and slippery moves.

The map is the task. Cells are numbered row by row: cell = row · width + column.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from upslope.errors import UpslopeError
from upslope.types import Key, Scalar

Cell = Int[Array, ""]

UP, DOWN, LEFT, RIGHT = range(4)

#: Channels of an observation; the last is there only where the game has traps.
START, GOAL, POSITION, OBSTACLES, TRAPS = range(5)

_ROW_STEPS = (-1, 1, 0, 0)
_COLUMN_STEPS = (0, 0, -1, 1)

#: Where a move can go: as meant, or, if it slips, to either side of it.
_SIDEWAYS = ((UP, LEFT, RIGHT), (DOWN, LEFT, RIGHT), (LEFT, UP, DOWN), (RIGHT, UP, DOWN))


class GridParams(eqx.Module):
    """One map.

    Attributes:
        obstacles: cells that can't be entered ``[height, width]``; never the start or the goal.
        traps: cells that end the episode with a penalty ``[height, width]``; never the start, the goal or an obstacle.
        start: cell in which episodes start.
        goal: cell whose entering ends the episode with reward 1; never the start.
        trap_penalty: what entering a trap costs.
        slip: probability that a move goes to one of its two sides, half of it to each; used by slippery games only.
        max_steps_in_episode: truncation.
    """

    obstacles: Bool[Array, "*maps height width"]
    traps: Bool[Array, "*maps height width"]
    start: Int[Array, "*maps"]
    goal: Int[Array, "*maps"]
    trap_penalty: Float[Array, "*maps"]
    slip: Float[Array, "*maps"]
    max_steps_in_episode: int = eqx.field(static=True, default=50)


class GridState(eqx.Module):
    """The agent's cell, and steps taken in this episode."""

    cell: Cell
    time: Int[Array, ""]


class Outcomes(NamedTuple):
    """Everything that can follow upon every action in every cell: the dynamics as tables.

    In goals, traps and obstacles nothing can be done: they lead to themselves, without reward, terminated.

    Attributes:
        successors: s' ``[cells, actions, outcomes]``; one outcome, or three where moves slip.
        probabilities: of each outcome.
        rewards: R(s, a, s').
        terminated: whether s' ends the episode.
        acting: cells in which one acts ``[cells]``.
    """

    successors: Int[Array, "cells actions outcomes"]
    probabilities: Float[Array, "cells actions outcomes"]
    rewards: Float[Array, "cells actions outcomes"]
    terminated: Bool[Array, "cells actions outcomes"]
    acting: Bool[Array, "cells"]


@dataclass(frozen=True)
class GridGame:
    """The environment, stateless, with the signature of gymnax ≥ 1.0.

    Actions go up (0), down (1), left (2) and right (3); into an obstacle or over the border one stays. Observations are
    0/1 channels ``[height, width, channels]``: start, goal, current position, obstacles, and traps if there are any.

    Attributes:
        height: rows.
        width: columns.
        traps: whether observations have the channel of traps.
        slippery: whether moves slip, with the map's probability.
        flat: whether observations are flattened, for networks that take vectors.
    """

    height: int
    width: int
    traps: bool = False
    slippery: bool = False
    flat: bool = False

    #: How many discrete actions.
    actions = 4

    @property
    def cells(self) -> int:
        return self.height * self.width

    @property
    def channels(self) -> int:
        return 5 if self.traps else 4

    @property
    def observation_shape(self) -> tuple[int, ...]:
        return (self.cells * self.channels,) if self.flat else (self.height, self.width, self.channels)

    def reset(self, key: Key, params: GridParams) -> tuple[Float[Array, "*obs"], GridState]:
        """Every episode starts in the map's start."""
        del key
        return self.observe(params, params.start), GridState(params.start, jnp.zeros((), jnp.int32))

    def step(
        self, key: Key, state: GridState, action: Any, params: GridParams
    ) -> tuple[Float[Array, "*obs"], GridState, Scalar, Bool[Array, ""], Bool[Array, ""], dict[str, Array]]:
        """One step, with automatic reset.

        Returns:
            Observation to act on, state, reward (1 at the goal, minus the penalty in a trap, else 0), terminated,
            truncated, and ``info["final_observation"]``: the true successor, which the observation is not where an
            episode ended.
        """
        direction = jnp.asarray(action, jnp.int32)
        if self.slippery:
            ways = jnp.asarray(_SIDEWAYS)[direction]
            direction = jax.random.choice(key, ways, p=_chances(params.slip))
        cell = self.move(params, state.cell, direction)
        reward, terminated = arrival(params, cell)
        time = state.time + 1
        truncated = (time >= params.max_steps_in_episode) & ~terminated
        done = terminated | truncated
        following = GridState(jnp.where(done, params.start, cell), jnp.where(done, 0, time))
        info = {"final_observation": self.observe(params, cell)}
        return self.observe(params, following.cell), following, reward, terminated, truncated, info

    def move(self, params: GridParams, cell: Cell, direction: Int[Array, ""]) -> Cell:
        """Where one stands after a move that did not slip."""
        row = cell // self.width + jnp.asarray(_ROW_STEPS)[direction]
        column = cell % self.width + jnp.asarray(_COLUMN_STEPS)[direction]
        inside = (row >= 0) & (row < self.height) & (column >= 0) & (column < self.width)
        there = jnp.where(inside, row * self.width + column, cell)
        return jnp.where(params.obstacles.ravel()[there], cell, there)

    def observe(self, params: GridParams, cell: Cell) -> Float[Array, "*obs"]:
        """What is seen from a cell."""
        layers = [jax.nn.one_hot(where, self.cells) for where in (params.start, params.goal, cell)]
        layers.append(params.obstacles.ravel().astype(layers[0].dtype))
        if self.traps:
            layers.append(params.traps.ravel().astype(layers[0].dtype))
        return jnp.stack(layers, axis=-1).reshape(self.observation_shape)

    def observe_all(self, params: GridParams) -> Float[Array, "cells *obs"]:
        """What is seen from every cell, obstacles and the goal included."""
        return jax.vmap(self.observe, in_axes=(None, 0))(params, jnp.arange(self.cells))

    def state_number(self, obs: Float[Array, "*obs"]) -> Cell:
        """The cell that an observation was made from."""
        return jnp.argmax(obs.reshape(self.cells, self.channels)[:, POSITION]).astype(jnp.int32)

    def outcomes(self, params: GridParams) -> Outcomes:
        """The dynamics of one map as tables."""
        cells = jnp.arange(self.cells)
        ways = jnp.asarray(_SIDEWAYS)[:, : 3 if self.slippery else 1]
        move = jax.vmap(jax.vmap(self.move, (None, None, 0)), (None, None, 0))
        successors = jax.vmap(move, (None, 0, None))(params, cells, ways)
        chances = _chances(params.slip) if self.slippery else jnp.ones(1)
        rewards, terminated = arrival(params, successors)
        idle = (cells == params.goal) | (params.obstacles | params.traps).ravel()
        stuck = idle[:, None, None]
        return Outcomes(
            jnp.where(stuck, cells[:, None, None], successors),
            jnp.broadcast_to(chances, successors.shape),
            jnp.where(stuck, 0.0, rewards),
            stuck | terminated,
            ~idle,
        )


def check_settings(slip: float, trap_penalty: float) -> None:
    """What maps of every origin must keep to.

    Raises:
        UpslopeError: a probability or a penalty that is none.
    """
    if not 0 <= slip < 1:
        raise UpslopeError(f"slip is {slip}, but it is a probability below 1: give one such as 0.2.")
    if not (math.isfinite(trap_penalty) and trap_penalty >= 0):
        raise UpslopeError(f"trap_penalty is {trap_penalty}, but traps cost something: give 0 or a positive number.")


def arrival(params: GridParams, cell: Int[Array, "*cells"]) -> tuple[Float[Array, "*cells"], Bool[Array, "*cells"]]:
    """The reward for entering cells of one map, and whether that ends the episode."""
    at_goal, trapped = cell == params.goal, params.traps.ravel()[cell]
    return jnp.where(at_goal, 1.0, jnp.where(trapped, -params.trap_penalty, 0.0)), at_goal | trapped


def _chances(slip: Scalar) -> Float[Array, "3"]:
    """Of going as meant, and to either side."""
    return jnp.stack([1 - slip, slip / 2, slip / 2])
