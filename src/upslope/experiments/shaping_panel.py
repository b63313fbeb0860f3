"""Shaping only (Fig. 1, middle and right; Figs. 3 and 5, right): one learner with every potential, in one program."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from upslope.experiments.keys import Purpose, keys_per_task
from upslope.experiments.results import EPISODE_LENGTH, Arm, Panel, Score, make_arm
from upslope.learners.ddpg import DDPG, DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import Shaping
from upslope.networks.dueling import DuelingQ
from upslope.priors.potentials import MeanPotential
from upslope.run.loop import run
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily
from upslope.types import Task


class ShapingArm(NamedTuple):
    """The potential of an arm: bias + scale · mean of K networks' V heads.

    Attributes:
        networks: the networks ``[seeds, tasks, K, ...]``.
        scale: factor of the mean.
        bias: added for each seed ``[seeds]``.
        terminal_discount: factor of Φ at terminal states; any value but zero is not policy-invariant.
    """

    networks: DuelingQ
    scale: float
    bias: np.ndarray
    terminal_discount: float = 0.0


def shaping_arms(
    family: AbstractFamily, priors: DuelingQ, levels: np.ndarray, oracles: DuelingQ | None, tasks: int
) -> dict[str, Shaping]:
    """The arms of a shaping comparison whose potentials are networks.

    Args:
        family: the family, for its γ.
        priors: the priors ``[seeds, ...]``.
        levels: each prior's mean potential ``[seeds]``.
        oracles: the oracles ``[tasks, ...]``; None leaves out that arm.
        tasks: the number of tasks.
    """
    seeds = levels.shape[0]
    shape = (seeds, tasks, seeds)

    def fill(networks: DuelingQ, axis: int) -> DuelingQ:
        """Networks along one axis of ``[seeds, tasks, K]``, repeated along the others."""

        def spread(leaf: Any) -> np.ndarray:
            lengths = [1, 1, 1]
            lengths[axis] = leaf.shape[0]
            array = np.asarray(leaf)
            return np.broadcast_to(array.reshape(*lengths, *array.shape[1:]), (*shape, *array.shape[1:]))

        return jax.tree.map(spread, networks)

    own, mean, none = fill(priors, 0), fill(priors, 2), np.zeros(seeds)
    arms = {
        "unshaped": ShapingArm(own, 0.0, none),
        "constant": ShapingArm(own, 0.0, levels),
        "prior": ShapingArm(own, 1.0, none),
        "prior_ensemble": ShapingArm(mean, 1.0, none),
        "prior_unzeroed": ShapingArm(own, 1.0, none, terminal_discount=family.gamma),
    }
    if oracles is not None:
        arms["oracle"] = ShapingArm(fill(oracles, 1), 1.0, none)
    return {name: _shaping(arm, seeds, tasks) for name, arm in arms.items()}


def shaping_panel(
    title: str,
    family: AbstractFamily,
    tasks: Task,
    arms: dict[str, Shaping],
    config: DQNConfig | DDPGConfig,
    first_seed: int,
    *,
    updates: int,
    every: int,
    session: Session | None = None,
    stage: str | None = None,
    score: Score = EPISODE_LENGTH,
) -> Panel:
    """Trains one agent per arm, seed and task. The arms share seeds, tasks and random numbers.

    Args:
        title: the title of the panel.
        family: of the tasks; DQN where its actions are discrete, DDPG where they are continuous.
        tasks: the tasks ``[tasks, ...]``.
        arms: each arm's shaping, stacked ``[seeds, tasks, ...]``; potentials of one form share one program.
        config: settings of the agents, the same for every arm.
        first_seed: the first seed of the runs.
        updates: updates of each agent.
        every: updates between evaluations.
        session: observers and checkpoints.
        stage: title of the runs, before the names of the arms; the learner's name if None.
        score: the meaning of the returns.
    """
    count = jax.tree.leaves(tasks)[0].shape[0]
    purpose = {"discrete": Purpose.MIDDLE, "continuous": Purpose.RIGHT}[family.actions.kind]
    finished: dict[str, Arm] = {}
    compiling = running = 0.0
    for name, shaping in arms.items():
        learner = shaping_learners(family, tasks, shaping, config)
        outcome = run(
            learner,
            keys_per_task(first_seed, jax.tree.leaves(shaping)[0].shape[0], count, purpose),
            updates=updates,
            every=every,
            title=f"{stage or type(learner).__name__} {name}",
            session=session,
        )
        finished[name] = make_arm(outcome.updates, outcome.reports, score)
        compiling += outcome.seconds_compiling
        running += outcome.seconds_running
    return Panel(title, finished, compiling, running)


def shaping_learners(
    family: AbstractFamily, tasks: Task, shaping: Shaping, config: DQNConfig | DDPGConfig
) -> DQN | DDPG:
    """An arm's agents ``[seeds, tasks]``, given its shaping ``[seeds, tasks, ...]``."""
    seeds = jax.tree.leaves(shaping)[0].shape[0]
    tasks_of_seeds = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (seeds, *leaf.shape)), tasks)
    if isinstance(config, DDPGConfig):
        return DDPG(family, tasks_of_seeds, shaping, config)
    return DQN(family, tasks_of_seeds, shaping, config)


def _shaping(arm: ShapingArm, seeds: int, tasks: int) -> Shaping:
    """An arm's shaping for every learner ``[seeds, tasks]``."""

    def fill(numbers: Any) -> jax.Array:
        return jnp.asarray(np.broadcast_to(np.asarray(numbers, np.float32), (seeds, tasks)))

    return Shaping(MeanPotential(arm.networks, fill(arm.scale), fill(arm.bias[:, None])), fill(arm.terminal_discount))
