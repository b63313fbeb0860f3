"""The priors of a figure, meta-trained in one program, with their snapshots; and an oracle for each task."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.experiments.keys import Purpose, key_for, keys_for
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ
from upslope.run.loop import broadcast, run
from upslope.run.outcome import Outcome
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Keys, Task


class Priors(NamedTuple):
    """The priors of several seeds.

    Attributes:
        final: the priors ``[seeds, ...]``, each the best of its snapshots on extra training tasks.
        snapshots: the priors at each of the iterations ``[seeds, snapshots, ...]``.
        iterations: the iterations of the snapshots ``[snapshots]``.
        returns: greedy returns of the snapshots on extra training tasks ``[seeds, snapshots]``.
        chosen: the iteration of each prior's best snapshot ``[seeds]``.
    """

    final: DuelingQ
    snapshots: DuelingQ
    iterations: np.ndarray
    returns: np.ndarray
    chosen: np.ndarray

    def stopped_at(self, iteration: int) -> DuelingQ:
        """The priors ``[seeds, ...]`` of Algorithm 1 stopped early, at the snapshot nearest to an iteration."""
        index = int(np.abs(self.iterations - iteration).argmin())
        return jax.tree.map(lambda leaf: leaf[:, index], self.snapshots)


def meta_train_priors(
    family: AbstractFamily,
    config: MetaTrainingConfig,
    first_seed: int,
    seeds: int,
    session: Session | None = None,
    title: str = "meta-training",
    allow_divergence: bool = False,
    until: int | None = None,
) -> Priors:
    """Algorithm 1, one prior per seed, all in one program; it stops at the iteration ``until`` if that is given."""
    outcome = run(
        broadcast(MetaTraining(family, config), (seeds,)),
        keys_for(first_seed, seeds, Purpose.META_TRAINING),
        updates=config.iterations,
        every=config.snapshot_every,
        until=until,
        title=title,
        session=session,
        allow_divergence=allow_divergence,
    )
    snapshots, returns = outcome.reports["prior"], outcome.reports["return"]
    chosen = outcome.updates[[config.best_snapshot(row) for row in returns]]
    return Priors(_best(outcome, config), snapshots, outcome.updates, returns, chosen)


def oracles(
    family: JaxTasks,
    tasks: Task,
    config: MetaTrainingConfig,
    first_seed: int,
    session: Session | None = None,
) -> DuelingQ:
    """Networks ``[tasks, ...]``, each trained to convergence on one task: their V heads are the oracle potentials.

    They are trained like the priors, on a family that always draws the one task.
    """
    outcome = run(
        *oracle_learners(family, tasks, config, first_seed),
        updates=config.iterations,
        every=config.snapshot_every,
        title="oracles",
        session=session,
    )
    return _best(outcome, config)


def oracle_learners(
    family: JaxTasks, tasks: Task, config: MetaTrainingConfig, first_seed: int
) -> tuple[MetaTraining, Keys]:
    """The learners of the oracles, and their keys ``[tasks]``."""
    count = jax.tree.leaves(tasks)[0].shape[0]
    return MetaTraining(family.only(tasks), config), jax.random.split(key_for(first_seed, Purpose.ORACLE), count)


def blank_priors(family: JaxTasks, config: MetaTrainingConfig, *batch: int) -> DuelingQ:
    """Networks ``[*batch, ...]`` of the priors' shapes, all zero, for programs compiled before the priors exist."""
    state = jax.eval_shape(MetaTraining(family, config).init, jax.random.key(0))
    return jax.tree.map(lambda leaf: np.zeros((*batch, *leaf.shape), leaf.dtype), state.average)


def _best(outcome: Outcome, config: MetaTrainingConfig) -> DuelingQ:
    """The best snapshot of every learner ``[learners, ...]``."""
    best = np.asarray([config.best_snapshot(row) for row in outcome.reports["return"]])
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[np.arange(len(best)), best]), outcome.reports["prior"])


@jax.jit
def mean_levels(family: JaxTasks, networks: DuelingQ, key: jax.Array) -> Float[Array, "seeds"]:
    """Each prior's mean potential over the states that it visits ε-greedily (ε = 0.1) on extra training tasks."""
    task_key, reset_key, act_key = jax.random.split(key, 3)
    tasks = family.sample_many(task_key, 20)

    def level(network: DuelingQ) -> Float[Array, ""]:
        running = family.reset(reset_key, tasks)
        _, transitions = family.collect(act_key, tasks, running, EpsilonGreedy(network, 0.1), family.max_steps)
        return jnp.mean(jax.vmap(jax.vmap(network.value))(transitions.obs))

    return jax.vmap(level)(networks)


@jax.jit
def zero_shot_returns(family: JaxTasks, networks: DuelingQ, tasks: Task, key: jax.Array) -> Float[Array, "seeds tasks"]:
    """The greedy return of each prior on each task, before any learning there: the mean of five episodes."""
    count = jax.tree.leaves(tasks)[0].shape[0]
    copies = jax.tree.map(lambda leaf: jnp.repeat(leaf, 5, axis=0), tasks)
    returns = jax.vmap(lambda network: family.returns(key, copies, Greedy(network)))(networks)
    return jnp.mean(returns.reshape(-1, count, 5), axis=-1)


def describe_priors(returns: np.ndarray, first_seed: int) -> list[dict[str, int | float]]:
    """One row per seed of `zero_shot_returns`: median, mean and lower quartile over the tasks."""
    return [
        {
            "seed": first_seed + index,
            "zero_shot_median": float(np.median(row)),
            "zero_shot_mean": float(np.mean(row)),
            "zero_shot_lower_quartile": float(np.percentile(row, 25)),
        }
        for index, row in enumerate(returns)
    ]
