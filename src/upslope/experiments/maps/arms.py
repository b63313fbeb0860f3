"""The shaping arms on maps: every potential is a table over the cells, so that all arms are one cheap program."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.learners.shaping import Shaping
from upslope.networks.dueling import DuelingQ
from upslope.planning.grid_potentials import CellPotential, manhattan_potential, optimal_potential
from upslope.planning.measures import truths
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Task


def grid_arms(
    family: JaxTasks, tasks: Task, priors: DuelingQ, control: DuelingQ, levels: Float[Array, "seeds"]
) -> dict[str, Shaping]:
    """The shaping of each arm ``[seeds, tasks, ...]``: learned potentials, hand-made ones, V*, and none.

    A frozen potential always gives the same value for a cell. Evaluating every network once for all cells saves the
    learners a pass through it in each of their steps.

    Args:
        family: the family of the maps.
        tasks: the maps ``[tasks, ...]``.
        priors: priors of Algorithm 1 ``[seeds, ...]``.
        control: priors of multi-task DQN ``[seeds, ...]``.
        levels: the constant potentials ``[seeds]``, from `mean_levels_on_maps`.
    """
    own, others = value_tables(family, tasks, priors), value_tables(family, tasks, control)
    values = {
        "unshaped": jnp.zeros_like(own),
        "constant": jnp.broadcast_to(levels[:, None, None], own.shape),
        "prior": own,
        "multi_task_dqn": others,
        "manhattan": manhattan_potential(family, tasks).values,
        "oracle": optimal_potential(family, tasks).values,
        "prior_ensemble": jnp.mean(own, axis=0),
        "prior_unzeroed": own,
    }
    return {
        name: Shaping(
            CellPotential(jnp.broadcast_to(table, own.shape)),
            jnp.full(own.shape[:2], family.gamma if name == "prior_unzeroed" else 0.0),
        )
        for name, table in values.items()
    }


def mean_levels_on_maps(family: JaxTasks, maps: Task, networks: DuelingQ) -> Float[Array, "seeds"]:
    """Each network's mean V over the cells that count of some maps, which are not those on which the level is used."""
    states = truths(family.env, maps, family.gamma).states
    return jnp.mean(value_tables(family, maps, networks), axis=(1, 2), where=states)


@eqx.filter_jit
def value_tables(family: JaxTasks, tasks: Task, networks: DuelingQ) -> Float[Array, "seeds tasks cells"]:
    """V of every network ``[seeds, ...]`` in every cell of every map ``[tasks, ...]``."""
    observations = jax.vmap(family.env.observe_all)(tasks)
    flat = observations.reshape(-1, *observations.shape[2:])
    of_all = jax.lax.map(lambda network: jax.vmap(network.value)(flat), networks)
    return of_all.reshape(-1, *observations.shape[:2])
