"""φ_i is a table of Q in every state: finite tasks solved as far as their replays say."""

from dataclasses import dataclass, field

import jax
import optax

from upslope.equations.maml import adapt
from upslope.learners.checks import check_counts, check_shares
from upslope.meta_training.posteriors.finite import (
    AbstractFinitePosterior,
    FiniteSamples,
    QTable,
    q_tables,
    table_td_loss,
)
from upslope.meta_training.posteriors.posterior import Name
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso
from upslope.types import Keys


@dataclass(frozen=True)
class TablePosterior(AbstractFinitePosterior):
    """φ_i is a table that starts at Q_θ in every state; adapting it costs next to nothing.

    With N = 1 and α = 1 the table is one Bellman backup, and Eq. 7 is the loss of multi-task DQN.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the share of each TD error that one step removes.
        inner_steps: N, the number of inner steps.
        reward_weight: weight of rewarded pairs of state and action in the outer loss.
        advantage_weight: weight, in the outer loss, of the differences between the errors of a state's actions.
        target_decay: decay per iteration of the averaged network from whose Q the table starts; None starts at Q_θ.
    """

    name: Name = field(default="table", init=False)

    target_decay: float | None = None

    def __post_init__(self) -> None:
        check_counts(self, "environments", "inner_steps")
        check_shares(target_decay=self.target_decay or 0.0)

    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        del torso
        return False  # no network has weights of its own for each task

    def draw(self, keys: Keys, replays: FiniteSamples, target: DuelingQ) -> FiniteSamples:
        del keys
        if self.target_decay is None:
            return replays
        return FiniteSamples(replays.observations, replays.steps, q_tables(target, replays.observations))

    def adapt(self, theta: DuelingQ, samples: FiniteSamples) -> QTable:
        """Q_φ of a task; it is Q_θ where nothing was tried."""
        base = jax.vmap(theta)(samples.observations) if samples.base is None else samples.base
        start = jax.lax.stop_gradient(base)
        return adapt(table_td_loss, start, samples.steps, step_size=self.inner_step_size, steps=self.inner_steps)

    def next_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        if self.target_decay is None:
            return theta
        return optax.incremental_update(theta, target, 1 - self.target_decay)
