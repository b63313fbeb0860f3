"""Random maps, drawn by the thousand, whose goal can always be reached, split for training and tests.

A map is drawn in three steps, and no map is rejected as unsolvable. First, each cell independently becomes an obstacle
or a trap with the given probabilities. Then the goal is drawn from the free cells that have a free neighbour, and the
start from the other cells from which the goal can be reached through free cells (by flood fill from the goal). Both are
uniform over these cells. If no cell can be the goal, as on tiny or very dense maps, two neighbouring cells are freed.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, UInt32

from upslope.envs.grid import GridParams
from upslope.types import Key

Split = Literal["all", "train", "test"]
HeldOut = Literal["maps", "goals"]
Mask = Bool[Array, "height width"]

#: The share of all maps, or of all goal cells, that belongs to the tests.
TEST_SHARE = 0.2


class RandomMaps(eqx.Module):
    """Draws one map of a split. The map alone determines its split, so draws cannot mix the splits.

    Attributes:
        height: rows.
        width: columns.
        obstacles: probability that a cell is an obstacle.
        traps: probability that a cell that is not an obstacle is a trap.
        trap_penalty: the trap penalty of every map.
        slip: the slip probability of every map.
        max_steps: number of steps after which an episode is truncated.
        split: the maps to draw: "all", "train" or "test".
        held_out: what training and test maps do not share: whole "maps", or even "goals".
    """

    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    obstacles: float = eqx.field(static=True)
    traps: float = eqx.field(static=True)
    trap_penalty: float = eqx.field(static=True)
    slip: float = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    split: Split = eqx.field(static=True)
    held_out: HeldOut = eqx.field(static=True)

    def __call__(self, key: Key) -> GridParams:
        if self.split == "all" or self.held_out == "goals":
            return self.draw(key)

        def again(carry: tuple[Key, GridParams, Bool[Array, ""]]) -> tuple[Key, GridParams, Bool[Array, ""]]:
            key, draw_key = jax.random.split(carry[0])
            drawn = self.draw(draw_key)
            return key, drawn, is_test_map(drawn) == (self.split == "test")

        # The loop starts without a map: the program then draws in one place, and compiles faster.
        nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(self.draw, key))
        return jax.lax.while_loop(lambda carry: ~carry[2], again, (key, nothing, jnp.asarray(False)))[1]

    def draw(self, key: Key) -> GridParams:
        """Draws one map: with a goal of the split if goals are held out, and from either split if maps are."""
        cell_key, goal_key, start_key, carve_key = jax.random.split(key, 4)
        shape = (self.height, self.width)
        lots = jax.random.uniform(cell_key, (2, *shape))
        obstacles = lots[0] < self.obstacles
        traps = ~obstacles & (lots[1] < self.traps)
        allowed = jnp.asarray(self.allowed_goals())
        free = ~(obstacles | traps)
        freed = _pair_to_free(carve_key, allowed)
        free = jnp.where(jnp.any(free & neighbours(free) & allowed), free, free | freed)
        goal = _any_of(goal_key, free & neighbours(free) & allowed)
        start = _any_of(start_key, reachable(free, goal) & (jnp.arange(free.size).reshape(shape) != goal))
        return GridParams(
            obstacles & ~free,
            traps & ~free,
            start,
            goal,
            jnp.asarray(self.trap_penalty, jnp.float32),
            jnp.asarray(self.slip, jnp.float32),
            self.max_steps,
        )

    def allowed_goals(self) -> Bool[np.ndarray, "height width"]:
        """The cells that can be goals in this split."""
        if self.split == "all" or self.held_out == "maps":
            return np.ones((self.height, self.width), bool)
        of_tests = held_out_goals(self.height, self.width)
        return of_tests if self.split == "test" else ~of_tests


def neighbours(mask: Mask) -> Mask:
    """The cells with a neighbour (above, below, left or right) in the mask."""
    padded = jnp.pad(mask, 1)
    return padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]


def reachable(free: Mask, goal: Int[Array, ""]) -> Mask:
    """The cells from which the goal can be reached through free cells, including the goal, by flood fill."""

    def spread(masks: tuple[Mask, Mask]) -> tuple[Mask, Mask]:
        _, mask = masks
        return mask, mask | (neighbours(mask) & free)

    start = (jnp.arange(free.size) == goal).reshape(free.shape)
    return jax.lax.while_loop(lambda masks: jnp.any(masks[0] != masks[1]), spread, spread((start, start)))[1]


def held_out_goals(height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """The goal cells of the tests: a fixed random fifth of all cells, at least one."""
    lots = np.random.default_rng([height, width]).random(height * width)
    count = max(1, round(TEST_SHARE * height * width))
    return (lots.argsort().argsort() < count).reshape(height, width)


def is_test_map(params: GridParams) -> Bool[Array, ""]:
    """Whether a map belongs to the tests, as a fifth of all maps do; a hash of the whole map decides."""
    return fingerprint(params) < np.uint32(TEST_SHARE * 2**32)


def fingerprint(params: GridParams) -> UInt32[Array, ""]:
    """A Zobrist hash: the sum of one fixed random number for each object in each cell."""
    height, width = params.obstacles.shape
    rng = np.random.default_rng([height, width, 1])
    numbers = jnp.asarray(rng.integers(2**32, size=(4, height * width), dtype=np.uint32))
    things = jnp.stack([params.obstacles.ravel(), params.traps.ravel()])
    return jnp.sum(numbers[:2], where=things, dtype=jnp.uint32) + numbers[2, params.start] + numbers[3, params.goal]


def _any_of(key: Key, mask: Mask) -> Int[Array, ""]:
    """Draws one cell of the mask uniformly."""
    lots = jnp.where(mask.ravel(), jax.random.uniform(key, (mask.size,)), -1.0)
    return jnp.argmax(lots).astype(jnp.int32)


def _pair_to_free(key: Key, allowed: Mask) -> Mask:
    """A random cell of the mask and one of its neighbours."""
    first_key, second_key = jax.random.split(key)
    cells = jnp.arange(allowed.size).reshape(allowed.shape)
    first = cells == _any_of(first_key, allowed)
    return first | (cells == _any_of(second_key, neighbours(first)))
