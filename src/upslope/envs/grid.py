"""Grid games (Sec. 5.2): maps of any size with a start, a goal, obstacles, and optionally traps and slippery moves.

The map is the task. Cells are numbered row by row: cell = row · width + column.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from upslope.envs import grid_rules as rules
from upslope.envs.grid_rules import Outcomes
from upslope.envs.map_text import read_board
from upslope.types import Key, Scalar

Cell = Int[Array, ""]


class GridParams(eqx.Module):
    """One map.

    Attributes:
        obstacles: cells that can't be entered ``[height, width]``; never the start or the goal.
        traps: cells that end the episode with a penalty ``[height, width]``; never the start, the goal or an obstacle.
        start: cell in which episodes start.
        goal: cell whose entering ends the episode with reward 1; never the start.
        trap_penalty: cost of entering a trap.
        slip: probability that a move slips, to either side with half of it; only slippery games use it.
        max_steps_in_episode: number of steps after which an episode is truncated.
    """

    obstacles: Bool[Array, "*maps height width"]
    traps: Bool[Array, "*maps height width"]
    start: Int[Array, "*maps"]
    goal: Int[Array, "*maps"]
    trap_penalty: Float[Array, "*maps"]
    slip: Float[Array, "*maps"]
    max_steps_in_episode: int = eqx.field(static=True, default=50)


class GridState(eqx.Module):
    """The agent's cell, and the number of steps in this episode."""

    cell: Cell
    time: Int[Array, ""]


@dataclass(frozen=True)
class GridGame:
    """The environment, stateless, with the signature of gymnax ≥ 1.0.

    Actions go up (0), down (1), left (2) and right (3); a move into an obstacle or over the border changes
    nothing. Observations are
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

    #: The number of discrete actions.
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
        """Every episode begins in the start cell."""
        del key
        return self.observe(params, params.start), GridState(params.start, jnp.zeros((), jnp.int32))

    def step(
        self, key: Key, state: GridState, action: Any, params: GridParams
    ) -> tuple[Float[Array, "*obs"], GridState, Scalar, Bool[Array, ""], Bool[Array, ""], dict[str, Array]]:
        """One step, with automatic reset.

        Returns:
            Observation to act on, state, reward (1 at the goal, minus the penalty in a trap, else 0), terminated,
            truncated, and ``info["final_observation"]``: the true successor; where an episode ended, the observation is
            the next one's.
        """
        direction = jnp.asarray(action, jnp.int32)
        if self.slippery:
            ways = jnp.asarray(rules.SIDEWAYS)[direction]
            direction = jax.random.choice(key, ways, p=rules.chances(jnp, params.slip))
        cell = self.move(params, state.cell, direction)
        reward, terminated = rules.arrival(jnp, params, cell)
        time = state.time + 1
        truncated = (time >= params.max_steps_in_episode) & ~terminated
        done = terminated | truncated
        following = GridState(jnp.where(done, params.start, cell), jnp.where(done, 0, time))
        info = {"final_observation": self.observe(params, cell)}
        return self.observe(params, following.cell), following, reward, terminated, truncated, info

    def move(self, params: GridParams, cell: Cell, direction: Int[Array, ""]) -> Cell:
        """The cell after a move that did not slip."""
        return rules.destination(jnp, params.obstacles, cell, direction)

    def observe(self, params: GridParams, cell: Cell) -> Float[Array, "*obs"]:
        """The observation in a cell."""
        return rules.observation(jnp, params, cell, traps=self.traps).reshape(self.observation_shape)

    def observe_all(self, params: GridParams) -> Float[Array, "cells *obs"]:
        """The observations in all cells, including obstacles and the goal."""
        return jax.vmap(self.observe, in_axes=(None, 0))(params, jnp.arange(self.cells))

    def state_number(self, obs: Float[Array, "*obs"]) -> Cell:
        """The cell of the agent in an observation."""
        return jnp.argmax(obs.reshape(self.cells, self.channels)[:, rules.POSITION]).astype(jnp.int32)

    def outcomes(self, params: GridParams) -> Outcomes:
        """The dynamics of one map as tables."""
        return rules.outcomes(jnp, params, slippery=self.slippery)


def read_map(text: str, *, trap_penalty: float = 1.0, slip: float = 0.0, max_steps: int = 50) -> GridParams:
    """Reads a map from text.

    Args:
        text: one line for each row; spaces around lines do not count.
        trap_penalty: cost of entering a trap.
        slip: probability that a move goes to one of its two sides instead.
        max_steps: number of steps after which an episode is truncated.

    Raises:
        UpslopeError: as in `read_board`.
    """
    board = read_board(text, trap_penalty=trap_penalty, slip=slip)
    parts = {name: jnp.asarray(part) for name, part in board._asdict().items()}
    return GridParams(**parts, max_steps_in_episode=max_steps)
