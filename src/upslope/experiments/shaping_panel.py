"""Shaping only (Fig. 1, middle and right; Figs. 3 and 5, right): one learner with every potential, one program."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from upslope.experiments.keys import Purpose, keys_per_task
from upslope.experiments.results import EPISODE_LENGTH, Arm, Panel, Score, arm_of
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
    """Which potential an arm shapes by: bias + scale · mean of K networks' V heads.

    Attributes:
        networks: ``[seeds, tasks, K, ...]``.
        scale: of the mean.
        bias: for each seed ``[seeds]``.
        terminal_discount: what multiplies Φ at terminal states; all but zero is not policy-invariant.
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
        family: of the tasks, for its γ.
        priors: ``[seeds, ...]``.
        levels: each prior's mean potential ``[seeds]``.
        oracles: ``[tasks, ...]``; None leaves that arm out.
        tasks: how many.
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
    """Trains one agent per arm, seed and task; arms share seeds, tasks and randomness.

    Args:
        title: of the panel.
        family: of the tasks; DQN where its actions are discrete, DDPG where they are continuous.
        tasks: ``[tasks, ...]``.
        arms: the shaping of each, stacked ``[seeds, tasks, ...]``; potentials of one form share one program.
        config: of the agent, the same for every arm.
        first_seed: of the runs.
        updates: of each agent.
        every: updates between evaluations.
        session: who watches, and where checkpoints go.
        stage: what its runs are called, before their arms' names; after the learner if None.
        score: what the returns are.
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
        finished[name] = arm_of(outcome.updates, outcome.reports, score)
        compiling += outcome.seconds_compiling
        running += outcome.seconds_running
    return Panel(title, finished, compiling, running)


def shaping_learners(
    family: AbstractFamily, tasks: Task, shaping: Shaping, config: DQNConfig | DDPGConfig
) -> DQN | DDPG:
    """An arm's agents ``[seeds, tasks]``, given its shaping ``[seeds, tasks, ...]``."""
    seeds = jax.tree.leaves(shaping)[0].shape[0]
    everywhere = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (seeds, *leaf.shape)), tasks)
    if isinstance(config, DDPGConfig):
        return DDPG(family, everywhere, shaping, config)
    return DQN(family, everywhere, shaping, config)


def _shaping(arm: ShapingArm, seeds: int, tasks: int) -> Shaping:
    """An arm's shaping for every learner ``[seeds, tasks]``."""

    def fill(numbers: Any) -> jax.Array:
        return jnp.asarray(np.broadcast_to(np.asarray(numbers, np.float32), (seeds, tasks)))

    return Shaping(MeanPotential(arm.networks, fill(arm.scale), fill(arm.bias[:, None])), fill(arm.terminal_discount))
