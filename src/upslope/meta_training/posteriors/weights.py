"""φ_i is the whole network, adapted to all of D_i."""

from dataclasses import dataclass, field

import jax

from upslope.meta_training.posteriors.adapted import AbstractAdaptedPosterior
from upslope.meta_training.posteriors.finite import FiniteSamples, QTable
from upslope.meta_training.posteriors.posterior import Name
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso


@dataclass(frozen=True)
class WeightsPosterior(AbstractAdaptedPosterior):
    """All weights are the task's.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the size of an inner step.
        inner_steps: N, the number of inner steps.
        reward_weight: weight of rewarded pairs of state and action in the outer loss.
        advantage_weight: weight, in the outer loss, of the differences between the errors of a state's actions.
        normalised_steps: use Polyak's steps: α is the share of a single squared error that one step removes.
    """

    name: Name = field(default="weights", init=False)

    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        return torso.takes_turns

    def adapt(self, theta: DuelingQ, samples: FiniteSamples) -> QTable:
        """Q_φ of a task in every state."""

        def q(network: DuelingQ) -> QTable:
            return jax.vmap(network)(samples.observations)

        return self.adapted(q, jax.lax.stop_gradient(theta), samples)
