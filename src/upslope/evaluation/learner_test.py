"""The test that counts: a short learner on fresh tasks, unshaped, with a constant potential, and shaped."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from upslope.learners.learner import AbstractTaskLearner
from upslope.learners.settings import AbstractLearnerConfig
from upslope.learners.shaping import Shaping
from upslope.networks.dueling import AbstractDueling
from upslope.priors.potentials import MeanPotential
from upslope.run.loop import run
from upslope.run.session import Session
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Task

#: The arms, and the scale and the share of the level of their potentials (`MeanPotential`).
ARMS = {"unshaped": (0.0, 0.0), "constant": (0.0, 1.0), "shaped": (1.0, 0.0)}


@dataclass(frozen=True)
class Difference:
    """A mean difference, with the bounds of its 95 % interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3g} ({self.low:.3g} to {self.high:.3g})"


@dataclass(frozen=True, eq=False, repr=False)
class LearnerTest:
    """Learning curves on the same tasks with the same random numbers.

    Attributes:
        learner: the name of the learner.
        updates: before each report ``[reports]``.
        returns: raw greedy returns ``[tasks, reports]`` of each arm.
    """

    learner: str
    updates: Int[np.ndarray, "reports"]
    returns: dict[str, Float[np.ndarray, "tasks reports"]]

    def areas(self, arm: str) -> Float[np.ndarray, "tasks"]:
        """The mean return of each learner over all its reports after the first update."""
        return self.returns[arm][:, 1:].mean(1)

    def gain(self, over: str, *, draws: int = 4000) -> Difference:
        """How much larger the area of the shaped arm is, with a bootstrap interval over tasks."""
        differences = self.areas("shaped") - self.areas(over)
        picked = np.random.default_rng(0).integers(len(differences), size=(draws, len(differences)))
        low, high = np.percentile(differences[picked].mean(1), [2.5, 97.5])
        return Difference(float(differences.mean()), float(low), float(high))


def compare_learners(
    family: AbstractFamily,
    network: AbstractDueling,
    level: float,
    tasks: Task,
    key: Key,
    config: AbstractLearnerConfig,
    *,
    updates: int,
    every: int,
    session: Session | None = None,
) -> LearnerTest:
    """Trains one learner for each arm and task ``[tasks, ...]``; all run side by side in one program.

    Args:
        family: the family of the tasks.
        network: its V shapes.
        level: the constant potential.
        tasks: fresh ones, stacked.
        key: of all random numbers; arms share them.
        config: settings of the learners, the same for all arms.
        updates: of each learner.
        every: updates between reports.
        session: observers and checkpoints.
    """
    count = len(jax.tree.leaves(tasks)[0])
    shape = (len(ARMS), count)
    spread = lambda leaf: jnp.broadcast_to(jnp.asarray(leaf), (*shape, *jnp.shape(leaf)))  # noqa: E731
    scale, share = (jnp.asarray(column, jnp.float32)[:, None] for column in zip(*ARMS.values(), strict=True))
    potential = MeanPotential(
        jax.tree.map(lambda leaf: spread(leaf[None]), network), _wide(scale, shape), _wide(level * share, shape)
    )
    shaping = Shaping(potential, jnp.zeros(shape))
    of_arms = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(ARMS), *jnp.shape(leaf))), tasks)
    learner: AbstractTaskLearner = config.build(family, of_arms, shaping)
    outcome = run(
        learner,
        jnp.broadcast_to(jax.random.split(key, count), shape),
        updates=updates,
        every=every,
        title=f"{config.name} with and without shaping",
        session=session,
        allow_divergence=True,
    )
    returns = dict(zip(ARMS, np.asarray(outcome.reports["return"]), strict=True))
    return LearnerTest(config.name, outcome.updates, returns)


def _wide(column: Float[Array, "arms 1"], shape: tuple[int, int]) -> Float[Array, "arms tasks"]:
    return jnp.broadcast_to(column, shape)
