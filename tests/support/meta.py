"""Algorithm 1, small enough to compute by hand."""

from dataclasses import replace

from support.probes import discrete_family
from upslope.equations.maml import meta_gradient, meta_loss
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior

TASKS, BATCH, ALPHA = 2, 3, 0.1
TINY = MetaTrainingConfig(
    iterations=4, tasks=TASKS, steps_per_task=8, hidden=(6, 5), outer_updates=2, evaluation_tasks=3,
    evaluation_episodes=2, posterior=NetworkPosterior(batch_size=BATCH, inner_step_size=ALPHA),
)  # fmt: skip


def learner(**changes) -> MetaTraining:
    """Algorithm 1 on the probe family, with some settings changed."""
    return MetaTraining(discrete_family(), replace(TINY, **changes))


def learner_by(**changes) -> MetaTraining:
    """Algorithm 1 on the probe family, with some of the posterior's settings changed."""
    return MetaTraining(discrete_family(), TINY.with_posterior(**changes))


def outer_loss(meta: MetaTraining, theta, samples):
    """The mean distance of θ from the φ_i (Eq. 7)."""
    posterior = meta.config.posterior
    return meta_loss(posterior.adapt, posterior.distance, theta, samples)


def outer_gradient(meta: MetaTraining, theta, samples):
    """The outer loss and its gradient (Eq. 3), as Algorithm 1 computes them."""
    posterior = meta.config.posterior
    return meta_gradient(posterior.adapt, posterior.distance, theta, samples, in_sequence=meta.in_sequence)
