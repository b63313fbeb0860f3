"""The families of grid games (Sec. 5.2): clean maps, maps with obstacles, and others."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from upslope.compiler_options import QUICK_TO_RUN
from upslope.envs.grid import GridGame, GridParams
from upslope.envs.grid_rules import check_settings
from upslope.errors import UpslopeError
from upslope.tasks.actions import DiscreteActions
from upslope.tasks.grid_maps import HeldOut, RandomMaps, Split
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Key

CLEAN_TRAINING_MAPS = 800
OBSTACLE_TRAINING_MAPS = 4000


class FixedMaps(eqx.Module):
    """Draws uniformly from a fixed set of maps."""

    maps: GridParams

    def __call__(self, key: Key) -> GridParams:
        chosen = jax.random.randint(key, (), 0, self.maps.start.shape[0])
        return jax.tree.map(lambda leaf: leaf[chosen], self.maps)


def grid_games(
    size: tuple[int, int] = (8, 8),
    *,
    obstacles: float = 0.2,
    traps: float = 0.0,
    trap_penalty: float = 1.0,
    slip: float = 0.0,
    gamma: float = 0.9,
    max_steps: int = 50,
    split: Split = "all",
    held_out: HeldOut = "maps",
    maps: int | None = None,
    maps_seed: int = 0,
    flat: bool = False,
) -> JaxTasks:
    """A p(T) over grid games. Every goal can be reached (see `upslope.tasks.grid_maps`).

    Args:
        size: rows and columns.
        obstacles: probability that a cell is an obstacle.
        traps: probability that a cell that is not an obstacle is a trap; above 0, observations have a channel of traps.
        trap_penalty: cost of entering a trap.
        slip: probability that a move goes to one of its two sides instead.
        gamma: γ of every task and of every potential learned here.
        max_steps: number of steps after which an episode is truncated.
        split: "train" and "test" share no map.
        held_out: "maps", or "goals": then no test goal is in a cell of a training goal.
        maps: number of distinct maps in a fixed set; None draws unlimited maps.
        maps_seed: seed of the fixed set.
        flat: whether observations are vectors instead of ``[height, width, channels]``.

    Raises:
        UpslopeError: the settings do not describe a game, or there are fewer maps than asked for.
    """
    _check(size, obstacles, traps, trap_penalty, slip, gamma, max_steps, split, held_out, maps)
    height, width = size
    env = GridGame(height, width, traps=traps > 0, slippery=slip > 0, flat=flat)
    sampler = RandomMaps(height, width, obstacles, traps, trap_penalty, slip, max_steps, split, held_out)
    family = JaxTasks(
        name="grid",
        env=env,
        sample_params=sampler,
        gamma=gamma,
        observation_shape=env.observation_shape,
        observation_scale=(1.0,) * env.observation_shape[-1],
        actions=DiscreteActions(env.actions),
        max_steps=max_steps,
        recipe="vectors" if flat else "maps",
    )
    if maps is None:
        return family
    return replace(family, sample_params=FixedMaps(distinct_maps(family, maps, maps_seed)))


def clean_maps(split: Split = "all", *, held_out: HeldOut = "maps", gamma: float = 0.9) -> JaxTasks:
    """The paper's 10 × 10 maps without obstacles. The training split is a fixed set of 800.

    There are only 100 goals, so most goals of unseen maps also occur in training; "goals" holds them out too.
    """
    maps = CLEAN_TRAINING_MAPS if split == "train" else None
    return grid_games((10, 10), obstacles=0.0, gamma=gamma, split=split, held_out=held_out, maps=maps)


def obstacle_maps(split: Split = "all", *, gamma: float = 0.9) -> JaxTasks:
    """The paper's 8 × 8 maps with an obstacle probability of 0.2. The training split is a fixed set of 4,000."""
    return grid_games(gamma=gamma, split=split, maps=OBSTACLE_TRAINING_MAPS if split == "train" else None)


def distinct_maps(family: JaxTasks, count: int, seed: int = 0) -> GridParams:
    """``count`` distinct maps of a family as one stacked PyTree ``[count, ...]``; the same maps for the same seed.

    Raises:
        UpslopeError: the family has too few.
    """
    key = jax.random.key(seed)
    at_once = max(count + count // 4, 256)
    found = _unique(_draw_many(family, key, at_once))
    for attempt in range(1, _ATTEMPTS):
        if len(found.start) >= count:
            break
        drawn = _draw_many(family, jax.random.fold_in(key, attempt), at_once)
        found = _unique(jax.tree.map(lambda *leaves: np.concatenate(leaves), found, drawn))
    if len(found.start) < count:
        raise UpslopeError(
            f"Only {len(found.start)} distinct maps were found where {count} were asked for: ask for fewer maps."
        )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[:count]), found)


#: The number of draws of more than ``count`` maps each. If they find too few, there are hardly any more.
_ATTEMPTS = 20

#: The number of cells from which both splits certainly hold many maps, so that drawing from a split ends.
_CELLS_TO_SPLIT = 12


@partial(jax.jit, static_argnames="count", compiler_options=QUICK_TO_RUN)
def _draw_many(family: JaxTasks, key: Key, count: int) -> GridParams:
    return family.sample_many(key, count)


def _unique(maps: GridParams) -> GridParams:
    """The maps without duplicates, in the order of first appearance. Uses NumPy, so that nothing is compiled."""
    maps = jax.tree.map(np.asarray, maps)
    layers = np.packbits(np.concatenate([maps.obstacles, maps.traps], axis=1).reshape(len(maps.start), -1), axis=1)
    ends = np.stack([maps.start, maps.goal], axis=1).astype(np.int32)
    rows = np.concatenate([layers, ends.view(np.uint8)], axis=1)
    first = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    return jax.tree.map(lambda leaf: leaf[first], maps)


def _check(
    size: tuple[int, int],
    obstacles: float,
    traps: float,
    trap_penalty: float,
    slip: float,
    gamma: float,
    max_steps: int,
    split: str,
    held_out: str,
    maps: int | None,
) -> None:
    height, width = size
    if height < 1 or width < 1 or height * width < 2:
        raise UpslopeError(f"A map of {height} × {width} cells holds no start and goal: give at least 2 cells.")
    check_settings(slip, trap_penalty)
    for name, share in (("obstacles", obstacles), ("traps", traps)):
        if not 0 <= share < 1:
            raise UpslopeError(f"{name} is {share}, but it is a probability below 1: give one such as 0.2.")
    if not 0 < gamma <= 1:
        raise UpslopeError(f"gamma is {gamma}, but a discount lies in (0, 1]: give one such as 0.9.")
    for name, count in (("max_steps", max_steps), ("maps", 1 if maps is None else maps)):
        if count < 1:
            raise UpslopeError(f"{name} is {count}, but it counts something: give at least 1.")
    if split not in ("all", "train", "test"):
        raise UpslopeError(f"There is no split {split!r}: choose all, train or test.")
    if held_out not in ("maps", "goals"):
        raise UpslopeError(f"{held_out!r} can't be held out: choose maps or goals.")
    if split != "all" and held_out == "maps" and height * width < _CELLS_TO_SPLIT:
        raise UpslopeError(
            f"{height} × {width} cells make too few maps to hold some out: give at least {_CELLS_TO_SPLIT} cells, "
            'or held_out="goals".'
        )
