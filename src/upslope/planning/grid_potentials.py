"""Potentials for grid games that are not learned: the optimal value, and one from the Manhattan distance."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.envs.grid import GridParams
from upslope.envs.grid_rules import POSITION
from upslope.planning.exact import solve_all
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Observation, Scalar


class CellPotential(eqx.Module):
    """Φ as a table over the cells of one map, looked up at the current position.

    Attributes:
        values: Φ of every cell ``[cells]``; stacked for stacked maps.
    """

    values: Float[Array, "*maps cells"]

    def __call__(self, obs: Observation) -> Scalar:
        position = obs.reshape(self.values.shape[-1], -1)[:, POSITION]  # flat observations too
        return jnp.sum(position * self.values)


def optimal_potential(family: JaxTasks, maps: GridParams) -> CellPotential:
    """V* of stacked maps ``[n, ...]``: the best potential (Thm. 3.1). The oracle.

    Without traps and slipping, V* is γ^(d − 1), where d is the length of the shortest path.
    """
    return CellPotential(solve_all(family.env, maps, family.gamma).value)


def manhattan_potential(family: JaxTasks, maps: GridParams) -> CellPotential:
    """A hand-designed potential for stacked maps ``[n, ...]``: V* as if there were no obstacles and no traps."""
    return CellPotential(_manhattan_of_all(family.env, maps, family.gamma))


@eqx.filter_jit
def _manhattan_of_all(env: Any, maps: GridParams, gamma: float) -> Float[Array, "n cells"]:
    return jax.vmap(lambda one: manhattan_values(env, one, gamma))(maps)


def manhattan_values(env: Any, params: GridParams, gamma: float) -> Float[Array, "cells"]:
    """γ^(d − 1) in every cell of one map, where d is the Manhattan distance to the goal; 0 at the goal, as in V*."""
    steps = manhattan_distance(env, params)
    return jnp.where(steps > 0, jnp.asarray(gamma) ** (steps - 1), 0.0)


def manhattan_distance(env: Any, params: GridParams) -> Int[Array, "cells"]:
    """Rows plus columns from every cell of one map to the goal."""
    cells = jnp.arange(env.cells)
    rows = jnp.abs(cells // env.width - params.goal // env.width)
    columns = jnp.abs(cells % env.width - params.goal % env.width)
    return rows + columns
