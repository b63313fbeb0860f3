"""Learns priors of grid games, and measures during training how near V comes to V*."""

from dataclasses import asdict
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.api import best_prior
from upslope.errors import UpslopeError
from upslope.experiments.keys import Purpose, key_for, keys_for
from upslope.experiments.maps.readings import GridPriorsConfig, Maps, training_title
from upslope.experiments.results import provenance
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ
from upslope.planning.exact import lookahead, steps_to_reward
from upslope.planning.grid_potentials import manhattan_distance
from upslope.planning.measures import Measures, Truth, dead_units, feature_norm, measure, summarise, truths
from upslope.priors.prior import Prior
from upslope.run.compiling import compile_clock
from upslope.run.loop import broadcast, run
from upslope.run.outcome import Outcome
from upslope.run.session import Session
from upslope.tasks import JaxTasks, clean_maps, obstacle_maps
from upslope.types import Task

#: The measures of single maps that results.json holds.
_STORED_MEASURES = ("rank_correlation", "success")


def families(maps: Maps) -> tuple[JaxTasks, JaxTasks]:
    """The family of training maps, and that of unseen maps."""
    if maps == "clean":
        return clean_maps("train", held_out="goals"), clean_maps("test", held_out="goals")
    return obstacle_maps("train"), obstacle_maps("test")


def run_grid_priors(
    config: GridPriorsConfig, session: Session | None = None
) -> tuple[dict[str, Any], dict[str, list[Prior]], dict[str, np.ndarray]]:
    """Learns every prior, and measures it on unseen maps during training.

    Returns:
        The content of results.json; the priors of each reading, one per seed; and all measures of the priors on
        single maps, as ``reading/measure`` to ``[seeds, maps]``, with the maps' mean ``detours`` ``[maps]``.
    """
    family, unseen = families(config.maps)
    rows: dict[str, Any] = {}
    priors: dict[str, list[Prior]] = {}
    singles: dict[str, np.ndarray] = {}
    with compile_clock() as clock:
        tasks = unseen.sample_many(key_for(config.first_seed, Purpose.TEST_TASKS), config.tasks)
        exact = truths(family.env, tasks, family.gamma)
        for name, (what, settings) in config.readings.items():
            outcome = run(
                broadcast(MetaTraining(family, settings), (config.seeds,)),
                keys_for(config.first_seed, config.seeds, Purpose.META_TRAINING),
                updates=settings.iterations,
                every=settings.snapshot_every,
                title=training_title(config.maps, name),
                session=session,
            )
            row = describe(family, exact, tasks, outcome, settings)
            singles |= {f"{name}/{measure}": np.asarray(seeds) for measure, seeds in row["maps"].items()}
            rows[name] = (
                {"what": what} | row | {"maps": {measure: row["maps"][measure] for measure in _STORED_MEASURES}}
            )
            priors[name] = [
                best_prior(family, outcome, settings, index, config.first_seed + index) for index in range(config.seeds)
            ]
    singles["detours"] = np.asarray(mean_detours(family, exact, tasks))
    results = {
        "figure": "grid priors",
        "maps": config.maps,
        "readings": rows,
        "detours": singles["detours"].tolist(),
        **provenance(
            clock,
            {
                "seeds": config.seeds,
                "first_seed": config.first_seed,
                "tasks": config.tasks,
                "readings": {name: asdict(reading.config) for name, reading in config.readings.items()},
            },
        ),
    }
    return results, priors, singles


def describe(
    family: JaxTasks, exact: Truth, tasks: Task, outcome: Outcome, config: MetaTrainingConfig
) -> dict[str, Any]:
    """The curves of one reading: each measure ``[seeds][snapshots]``, as mean, median and worst over maps.

    For the final priors, the result also has the single maps ``[seeds][maps]``.
    """
    seeds, snapshots = outcome.reports["return"].shape
    chosen = [config.best_snapshot(row) for row in outcome.reports["return"]]
    curves: dict[str, Any] = {}
    maps: dict[str, list[list[float]]] = {name: [] for name in Measures._fields}
    for seed in range(seeds):
        for index in range(snapshots):
            network = jax.tree.map(lambda leaf, i=seed, j=index: jnp.asarray(leaf[i, j]), outcome.reports["prior"])
            measures, health = examine(family, exact, tasks, network)
            if index == chosen[seed]:
                for name, of_seeds in maps.items():
                    of_seeds.append(getattr(measures, name).tolist())
            numbers = summarise(measures) | {name: {"mean": float(value)} for name, value in health.items()}
            for name, kinds in numbers.items():
                for kind, number in kinds.items():
                    rows = curves.setdefault(name, {}).setdefault(kind, [[] for _ in range(seeds)])
                    rows[seed].append(number)
    return {
        "iterations": outcome.updates.tolist(),
        "seconds": (outcome.seconds - outcome.seconds[0]).tolist(),
        "seconds_compiling": outcome.seconds_compiling,
        "outer_loss": outcome.metrics["outer_loss"].tolist(),
        "success_on_training_maps": outcome.reports["return"].tolist(),
        "chosen": [int(outcome.updates[index]) for index in chosen],
        "measures": curves,
        "final": {
            name: [float(row[index]) for row, index in zip(kinds["mean"], chosen, strict=True)]
            for name, kinds in curves.items()
        },
        "maps": maps,
    }


def mean_detours(family: JaxTasks, exact: Truth, tasks: Task) -> Float[Array, "tasks"]:
    """By how many steps the shortest path exceeds the rows and columns to the goal: a mean over the states that count.

    Paths lead around traps. Where moves slip there is no shortest path.

    Raises:
        UpslopeError: the family's moves slip.
    """
    if family.env.slippery:
        raise UpslopeError("Where moves slip there is no shortest path: measure detours with grid_games(slip=0.0).")
    straight = jax.vmap(lambda one: manhattan_distance(family.env, one))(tasks)
    detours = jax.vmap(steps_to_reward)(exact.mdp) - straight
    return jnp.mean(detours.astype(float), axis=-1, where=exact.states)


@eqx.filter_jit
def examine(
    family: JaxTasks, exact: Truth, tasks: Task, network: DuelingQ
) -> tuple[Measures, dict[str, Float[Array, ""]]]:
    """All measures of single tasks ``[tasks]``, and signs of a collapse, from one pass through the network.

    The signs are the TD residual over all states that count, the norm of the features, and the share of dead units.
    """

    def of_one(pair: tuple[Truth, Task]) -> tuple[Measures, Float[Array, ""], Float[Array, "states units"]]:
        exact, task = pair
        features = jax.vmap(network.features)(family.env.observe_all(task))
        value, advantage = jax.vmap(network.heads_on)(features)
        q = network.advantage_head.each_q(value, advantage)
        return measure(exact, value, q, family.max_steps), td_residual(exact, value, q), features

    # One task at a time: on CPUs convolutions are twice as fast when the data fit the caches.
    measures, residuals, features = jax.lax.map(of_one, (exact, tasks))
    features = features.reshape(-1, features.shape[-1])
    health = {
        "td_residual": jnp.mean(residuals),
        "feature_norm": feature_norm(features),
        "dead_units": dead_units(features),
    }
    return measures, health


def td_residual(exact: Truth, value: Float[Array, "states"], q: Float[Array, "states actions"]) -> Float[Array, ""]:
    """Mean squared TD error of a table on one task, over all actions of the states that count."""
    squares = (lookahead(exact.mdp, value) - q) ** 2
    return jnp.mean(squares, where=exact.states[:, None])
