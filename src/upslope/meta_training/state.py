"""What changes while Algorithm 1 runs."""

import equinox as eqx
import optax
from jaxtyping import Array, Int

from upslope.meta_training.posteriors.posterior import Replays
from upslope.meta_training.statistics import Statistics
from upslope.networks.dueling import DuelingQ
from upslope.types import Key


class MetaTrainingState(eqx.Module):
    """All that changes while meta-training.

    Attributes:
        theta: θ.
        acting: collects experience: θ, or θ one iteration ago for families that collect while gradients are computed.
        target: the averaged network of the inner TD target.
        average: moving average of θ: the prior.
        iteration: how many came before.
        kept: the replays of the latest iterations ``[iterations · tasks, ...]``; None if only the last ones are used.
        statistics: what the random iterations showed; None if nothing is normalised.
        trial_key: draws the extra training tasks; the same for every snapshot, so that they compare.
    """

    key: Key
    trial_key: Key
    theta: DuelingQ
    acting: DuelingQ
    target: DuelingQ
    average: DuelingQ
    optimiser: optax.OptState
    iteration: Int[Array, "*batch"]
    kept: Replays | None
    statistics: Statistics | None


class Learned(eqx.Module):
    """What changes from one outer step to the next."""

    theta: DuelingQ
    optimiser: optax.OptState
    target: DuelingQ

    @staticmethod
    def of(state: MetaTrainingState) -> "Learned":
        return Learned(state.theta, state.optimiser, state.target)
