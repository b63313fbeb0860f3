"""φ_i is θ with two heads of its own, adapted to all of D_i."""

from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax

from upslope.meta_training.posteriors.adapted import AbstractAdaptedPosterior
from upslope.meta_training.posteriors.finite import FiniteSamples, QTable
from upslope.meta_training.posteriors.posterior import Name
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso


@dataclass(frozen=True)
class HeadsPosterior(AbstractAdaptedPosterior):
    """The torso stays θ's; V head and A head are the task's.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the size of an inner step.
        inner_steps: N, the number of inner steps.
        reward_weight: weight of rewarded pairs of state and action in the outer loss.
        advantage_weight: weight, in the outer loss, of the differences between the errors of a state's actions.
        normalised_steps: use Polyak's steps: α is the share of a single squared error that one step removes.
    """

    name: Name = field(default="heads", init=False)

    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        del torso
        return False  # all tasks share the convolutions

    def adapt(self, theta: DuelingQ, samples: FiniteSamples) -> QTable:
        """Q_φ of a task in every state."""
        theta = jax.lax.stop_gradient(theta)
        features = jax.vmap(theta.features)(samples.observations)

        def q(heads: tuple[Any, Any]) -> QTable:
            network = eqx.tree_at(lambda network: (network.value_head, network.advantage_head), theta, heads)
            return heads[1].each_q(*jax.vmap(network.heads_on)(features))

        return self.adapted(q, (theta.value_head, theta.advantage_head), samples)
