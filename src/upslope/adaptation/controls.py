"""Two controls that show where Algorithm 2's gain comes from: each changes one thing about it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from upslope.adaptation.algorithm2 import Algorithm2, UpdateRule, advantage_step_loss
from upslope.equations.losses import dueling_q, td_loss
from upslope.equations.maml import descend
from upslope.networks.dueling import AbstractDueling, DuelingQ
from upslope.types import Action, Observation, Scalar, Transition


class FrozenPotential(eqx.Module):
    """V frozen at the prior, with two centred A steps: pure shaping. Shows the effect of adapting the potential."""

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        level = Algorithm2(centred=True).level(prior)
        for _ in range(2):
            phi = descend(phi, jax.grad(advantage_step_loss)(phi, prior, batch, level), step_size)
        return phi


class CentredTD(eqx.Module):
    """One TD step on V + A − frozen max A. Shows the effect of not differentiating through the current maximum."""

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        return descend(phi, jax.grad(centred_td_loss)(phi, prior, batch), step_size)


def centred_td_loss(phi: DuelingQ, prior: AbstractDueling, batch: Transition) -> Scalar:
    """Mean of Eq. 5 for Q(s, ·) = V(s) + A(s, ·) − the prior's max A(s, ·)."""

    def loss(obs: Observation, action: Action, reward: Scalar, discount: Scalar, next_obs: Observation) -> Scalar:
        head = phi.advantage_head
        (value, outputs), (next_value, next_outputs) = phi.heads(obs), phi.heads(next_obs)
        q = dueling_q(value, head.advantage(outputs, action), prior.highest_advantage(obs))
        highest_next_q = dueling_q(next_value, head.highest(next_outputs), prior.highest_advantage(next_obs))
        return td_loss(q, reward, discount, jax.lax.stop_gradient(highest_next_q))

    return jnp.mean(jax.vmap(loss)(*batch))


class OneOf(eqx.Module):
    """One of several rules, chosen by index, so that a comparison of all rules compiles one program."""

    rules: tuple[UpdateRule, ...]
    index: Int[Array, ""]

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        return jax.lax.switch(self.index, [rule.update for rule in self.rules], phi, prior, batch, step_size)
