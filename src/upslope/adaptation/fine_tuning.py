"""The MAML baseline: fine-tuning of the whole prior by Q-learning, without shaping."""

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.equations.losses import td_loss
from upslope.equations.maml import adapt
from upslope.networks.dueling import AbstractDueling, DuelingQ
from upslope.types import Scalar, Transition


class FineTuning(eqx.Module):
    """MAML's adaptation to a new task: Eq. 2 on the TD error of Eq. 5.

    Attributes:
        steps: gradient steps per update. With two, there are as many gradient steps as in one update of Algorithm 2.
    """

    steps: int = eqx.field(static=True, default=1)

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        del prior
        return adapt(fine_tuning_loss, phi, batch, step_size=step_size, steps=self.steps)


def fine_tuning_loss(phi: DuelingQ, batch: Transition) -> Scalar:
    """Mean of Eq. 5 with Eq. 6's Q and a constant target."""
    next_value = jax.lax.stop_gradient(jax.vmap(phi.value)(batch.next_obs))
    q = jax.vmap(phi.q)(batch.obs, batch.action)
    return jnp.mean(jax.vmap(td_loss)(q, batch.reward, batch.discount, next_value))
