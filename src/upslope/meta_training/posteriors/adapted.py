"""Posteriors for finite tasks whose φ_i are parameters of the network, adapted by Eq. 2 to all of D_i."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from upslope.equations.maml import adapt
from upslope.meta_training.posteriors.finite import AbstractFinitePosterior, FiniteSamples, QTable, mean_td_loss
from upslope.networks.dueling import DuelingQ
from upslope.types import Keys


@dataclass(frozen=True)
class AbstractAdaptedPosterior(AbstractFinitePosterior):
    """φ_i starts at parameters of θ, and is adapted to the mean of Eq. 5 over D_i.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the size of an inner step.
        inner_steps: N, the number of inner steps.
        reward_weight: weight of rewarded pairs of state and action in the outer loss.
        advantage_weight: weight, in the outer loss, of the differences between the errors of a state's actions.
        normalised_steps: use Polyak's steps: α is the share of a single squared error that one step removes.
    """

    normalised_steps: bool = False

    def draw(self, keys: Keys, replays: FiniteSamples, target: DuelingQ) -> FiniteSamples:
        del keys, target
        return replays

    def adapted(self, q: Callable[[Any], QTable], start: Any, samples: FiniteSamples) -> QTable:
        """Q_φ of a task in every state.

        Args:
            q: Q in every state, given parameters.
            start: the parameters of θ from which φ starts.
            samples: D_i.
        """

        def loss(parameters: Any, samples: FiniteSamples) -> Any:
            return mean_td_loss(q(parameters), samples.steps)

        return q(
            adapt(
                loss,
                start,
                samples,
                step_size=self.inner_step_size,
                steps=self.inner_steps,
                normalised=self.normalised_steps,
            )
        )

    def next_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        del target
        return theta
