"""The steps of the learners cut off after each of their phases, so that the differences in time are the phases'.

Each phase is a function of a learner and its state that gives the next state and a number made from all that the phase
computed, so that no compiler leaves it out. The last phase is the learner's own step.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from upslope.adaptation.algorithm2 import Adaptation, AdaptationState
from upslope.equations.maml import meta_gradient
from upslope.learners.ddpg import DDPG, DDPGState, critic_loss
from upslope.learners.dqn import DQN, DQNState, dqn_loss
from upslope.learners.experience import Experience
from upslope.learners.learner import AbstractLearner
from upslope.learners.shaping import add_shaping
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.state import MetaTrainingState
from upslope.types import Scalar, Transition

Phase = Callable[[Any, Any], tuple[Any, Scalar]]


def total(tree: Any) -> Scalar:
    """The sum of all numbers of a PyTree."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.number)]
    return sum((jnp.sum(leaf).astype(jnp.float32) for leaf in leaves), jnp.zeros(()))


def whole(learner: AbstractLearner, state: Any) -> tuple[Any, Scalar]:
    """The learner's own step."""
    state, metrics = learner.step(state)
    return state, total(metrics)


def _next_key(state: Any) -> Any:
    return jax.random.split(state.key, 2)[0]


# Algorithm 1.


def meta_collect(meta: MetaTraining, state: MetaTrainingState) -> tuple[MetaTrainingState, Scalar]:
    """Tasks are drawn, and fresh replays collected."""
    return replace(state, key=_next_key(state)), total(meta.gather(state))


def meta_draw(meta: MetaTraining, state: MetaTrainingState) -> tuple[MetaTrainingState, Scalar]:
    """Batches, with the averaged network's values, as often as there are outer updates."""
    gathered = meta.gather(state)
    keys = jax.random.split(state.key, meta.config.outer_updates)
    drawn = jax.lax.map(lambda key: total(meta.draw(key, gathered, state.target)), keys)
    return replace(state, key=_next_key(state)), jnp.sum(drawn)


def meta_gradients(meta: MetaTraining, state: MetaTrainingState) -> tuple[MetaTrainingState, Scalar]:
    """The outer gradients, the inner steps in them."""
    gathered, posterior = meta.gather(state), meta.config.posterior

    def one(theta: Any, key: Any) -> tuple[Any, Scalar]:
        samples = meta.draw(key, gathered, state.target)
        loss, gradient = meta_gradient(
            posterior.adapt, posterior.distance, theta, samples, in_sequence=meta.in_sequence
        )
        return jax.tree.map(lambda leaf, slope: leaf - 1e-6 * slope, theta, gradient), loss

    keys = jax.random.split(state.key, meta.config.outer_updates)
    theta, losses = jax.lax.scan(one, state.theta, keys)
    return replace(state, key=_next_key(state), theta=theta), jnp.sum(losses)


META_TRAINING: dict[str, Phase] = {
    "collecting": meta_collect,
    "drawing batches, TD targets": meta_draw,
    "inner steps, outer gradients": meta_gradients,
    "Adam, averages, metrics": whole,
}


# DQN, DDPG and adaptation: the same three phases first.


def act(learner: Any, state: Any) -> tuple[Any, Scalar]:
    """Steps in the environment."""
    running, seen = learner.gather(state)
    experience = Experience(running, state.experience.replay)
    return replace(state, key=_next_key(state), experience=experience), total(seen)


def remember(learner: Any, state: Any) -> tuple[Any, Scalar]:
    """F of the steps, and the write to the replay."""
    running, seen = learner.gather(state)
    experience = state.experience.remember(running, seen, getattr(learner, "shaping", None))
    return replace(state, key=_next_key(state), experience=experience), total(seen)


def sample(learner: Any, state: Any) -> tuple[Any, Scalar]:
    """The batch, shaped."""
    state, _ = remember(learner, state)
    return state, total(_batch(learner, state))


def _batch(learner: Any, state: Any) -> Transition:
    return add_shaping(*state.experience.sample(state.key, learner.config.batch_size))


def dqn_gradient(learner: DQN, state: DQNState) -> tuple[DQNState, Scalar]:
    """Forward and back."""
    state, _ = remember(learner, state)
    batch = _batch(learner, state)
    return state, total(jax.grad(dqn_loss)(state.network, state.target, batch, learner.config.huber_threshold))


def ddpg_critic(learner: DDPG, state: DDPGState) -> tuple[DDPGState, Scalar]:
    """The critic, forward and back."""
    state, _ = remember(learner, state)
    batch, threshold = _batch(learner, state), learner.config.huber_threshold
    return state, total(jax.grad(critic_loss)(state.critic, state.target_actor, state.target_critic, batch, threshold))


def adaptation_rule(learner: Adaptation, state: AdaptationState) -> tuple[AdaptationState, Scalar]:
    """Eqs. 8 and 9."""
    state, _ = remember(learner, state)
    phi = learner.rule.update(state.phi, learner.prior, _batch(learner, state), learner.step_size)
    return replace(state, phi=phi), total(phi)


_FIRST: dict[str, Phase] = {"acting": act, "F, writing to the replay": remember, "sampling the batch": sample}
DQN_PHASES = _FIRST | {"gradient": dqn_gradient, "Adam, target network, metrics": whole}
DDPG_PHASES = _FIRST | {"critic's gradient": ddpg_critic, "actor's gradient, Adam, targets, metrics": whole}
ADAPTATION_PHASES = _FIRST | {"both steps of the rule": adaptation_rule, "metrics": whole}
