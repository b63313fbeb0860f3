"""The maps on which the theorems are checked, solved in double precision."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from upslope.envs.grid import GridGame, GridParams
from upslope.experiments.keys import Purpose, key_for
from upslope.planning.exact import value_iteration
from upslope.planning.measures import Truth, truth
from upslope.tasks import JaxTasks, clean_maps, grid_games, obstacle_maps

#: The precision of exact values. What is called zero is zero to within this.
TOLERANCE = 1e-9


class Maps(NamedTuple):
    """Stacked maps of one kind.

    Attributes:
        env: the environment of the maps.
        params: the maps ``[n, ...]``, with floats in double precision.
        gamma: γ.
    """

    env: GridGame
    params: GridParams
    gamma: float


def kinds() -> dict[str, JaxTasks]:
    """The paper's two families, and two more: with traps, and with traps and slippery moves."""
    return {
        "clean 10×10": clean_maps(),
        "obstacles 8×8": obstacle_maps(),
        "traps 8×8": grid_games(traps=0.1),
        "traps, slippery 8×8": grid_games(traps=0.1, slip=0.2),
    }


def draw_maps(family: JaxTasks, count: int, seed: int) -> Maps:
    """Maps of one kind. Call it in single precision, so that they are the maps that learners see."""
    params = jax.jit(lambda key: family.sample_many(key, count))(key_for(seed, Purpose.TEST_TASKS))
    with jax.enable_x64(True):
        params = jax.tree.map(
            lambda leaf: leaf.astype(float) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, params
        )
    return Maps(family.env, params, family.gamma)


def exact_truth(maps: Maps, params: GridParams) -> Truth:
    """The exact values of one map: V* and Q* to within `TOLERANCE`."""
    rounded = truth(maps.env, params, maps.gamma)
    solution = value_iteration(rounded.mdp, tolerance=TOLERANCE / 100)
    return Truth(rounded.mdp, solution, rounded.states, rounded.start)


def for_each(function: Any, *stacked: Any) -> Any:
    """A function over stacked maps ``[n, ...]``, compiled; 100 at a time, to save memory. Returns NumPy arrays."""
    mapped = jax.jit(lambda *trees: jax.lax.map(lambda slices: function(*slices), trees, batch_size=100))
    return jax.device_get(mapped(*stacked))
