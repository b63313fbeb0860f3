"""What changes while Algorithm 1 runs."""

import equinox as eqx
import optax

from upslope.networks.dueling import DuelingQ
from upslope.types import Key


class MetaTrainingState(eqx.Module):
    """All that changes while meta-training.

    Attributes:
        theta: θ.
        acting: collects experience: θ, or θ one iteration ago for families that collect while gradients are computed.
        target: the averaged network of the inner TD target.
        average: moving average of θ: the prior.
        trial_key: draws the extra training tasks; the same for every snapshot, so that they compare.
    """

    key: Key
    trial_key: Key
    theta: DuelingQ
    acting: DuelingQ
    target: DuelingQ
    average: DuelingQ
    optimiser: optax.OptState
