"""Algorithm 1: meta-learning the potential function prior."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from upslope.equations.maml import meta_gradient
from upslope.learners.learner import AbstractTaskLearner
from upslope.learners.policies import Greedy
from upslope.learners.sharing import mean_of_all, most_devices, own_tasks
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors.posterior import AbstractPosterior, Replays, Samples, repeat_tasks
from upslope.meta_training.state import MetaTrainingState
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import head_class
from upslope.networks.precision import with_precision
from upslope.networks.torsos import torso_class
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Metrics, Policy, Scalar, Task


class MetaTraining(AbstractTaskLearner):
    """Algorithm 1. One step is one meta-iteration; the state's ``average`` is the prior.

    Attributes:
        shared_over: the axis of a mesh whose devices share the tasks of each outer gradient; None for one device.
    """

    family: AbstractFamily
    config: MetaTrainingConfig = eqx.field(static=True, default=MetaTrainingConfig())
    shared_over: str | None = eqx.field(static=True, default=None)

    def gather(self, state: MetaTrainingState) -> Replays:
        """Lines 3 to 5: sample tasks M_i ~ p(T), and collect their replays D_i."""
        key, tasks = self.sample_tasks(state.key)
        return self.collect(key, tasks, self.behaviour(tasks, state.acting))()

    def update(self, state: MetaTrainingState, gathered: Replays) -> tuple[MetaTrainingState, Metrics]:
        """Lines 6 to 9: adapt each φ_i, measure its distance from θ, and take outer steps."""
        posterior, (key, _, _, update_key) = self.config.posterior, jax.random.split(state.key, 4)
        replays = own_tasks(gathered, self.shared_over)

        def outer_step(carry: tuple[DuelingQ, optax.OptState], key: Key) -> tuple[tuple[DuelingQ, Any], Metrics]:
            theta, optimiser = carry
            keys = own_tasks(jax.random.split(key, self.config.tasks), self.shared_over)
            samples = posterior.draw(keys, replays, state.target)
            loss, gradient = mean_of_all(self.outer_gradient(theta, samples), self.shared_over)
            change, optimiser = self.config.optimiser().update(gradient, optimiser)
            metrics = {"outer_loss": loss, "gradient_norm": optax.tree.norm(gradient)}
            return (optax.apply_updates(theta, change), optimiser), metrics

        keys = jax.random.split(update_key, self.config.outer_updates)
        (theta, optimiser), metrics = jax.lax.scan(outer_step, (state.theta, state.optimiser), keys)
        following = MetaTrainingState(
            key,
            state.trial_key,
            theta,
            self.family.acting_network(theta, state.theta),
            posterior.next_target(theta, state.target),
            optax.incremental_update(theta, state.average, 1 - self.config.averaging),
            optimiser,
        )
        return following, posterior.vital_signs(gathered) | jax.tree.map(jnp.mean, metrics)

    def outer_gradient(self, theta: DuelingQ, samples: Samples) -> tuple[Scalar, DuelingQ]:
        """E_i of the distance of θ and φ_i (Eq. 7), φ_i adapted from θ (Eq. 2), and its gradient (Eq. 3)."""
        posterior: AbstractPosterior = self.config.posterior
        in_sequence = posterior.in_sequence(type(theta.torso))
        return meta_gradient(posterior.adapt, posterior.distance, theta, samples, in_sequence=in_sequence)

    def sample_tasks(self, key: Key) -> tuple[Key, Task]:
        """The tasks ``[tasks, ...]`` of the iteration that begins with this key, and a key to collect with."""
        _, task_key, collect_key, _ = jax.random.split(key, 4)
        return collect_key, self.family.sample_many(task_key, self.config.tasks)

    def behaviour(self, tasks: Task, theta: DuelingQ) -> Policy:
        """ε-greedy by Q_θ, with its own ε for each task or environment."""
        return self.config.posterior.policy(theta, self.family, tasks, self.config.epsilon)

    def collect(self, key: Key, tasks: Task, policy: Policy) -> Callable[[], Replays]:
        """Fresh replays D_i ``[tasks, ...]``; the environments take their steps when the result is called."""
        posterior, family = self.config.posterior, self.family
        environments = repeat_tasks(tasks, posterior.environments)
        rollout = family.rollout_later(key, environments, policy, self.config.steps_per_task)
        return lambda: posterior.replays(family, tasks, rollout())

    def gather_ahead(self, state: MetaTrainingState) -> Callable[[], Replays]:
        return self.collect(*_ahead(self, state.key, state.theta))

    def init(self, key: Key) -> MetaTrainingState:
        """θ with random weights.

        Raises:
            UpslopeError: a family that the posterior does not fit, or whose actions no head fits.
        """
        key, trial_key, network_key = jax.random.split(key, 3)
        family, config = self.family, self.config
        config.posterior.check(family)
        theta = DuelingQ(
            network_key,
            family.observation_shape,
            family.actions.count,
            config.hidden,
            family.observation_scale,
            config.activation,
            head_class(config.head, family.actions.kind),
        )
        theta = with_precision(theta, config.precision)
        return MetaTrainingState(key, trial_key, theta, theta, theta, theta, config.optimiser().init(theta))

    def report(self, state: MetaTrainingState) -> dict[str, Any]:
        """The prior as it stands, and its mean greedy return on extra training tasks."""
        task_key, episode_key = jax.random.split(state.trial_key)
        tasks = self.family.sample_many(task_key, self.config.evaluation_tasks)
        tasks = repeat_tasks(tasks, self.config.evaluation_episodes)
        returns = self.family.returns(episode_key, tasks, Greedy(state.average))
        return {"return": jnp.mean(returns), "prior": state.average}

    def most_devices(self, devices: int) -> int:
        # Cores of one CPU wait for each other at each outer step, and all gather: only long tasks are worth it.
        torso = torso_class(self.family.observation_shape)
        is_short = jax.default_backend() == "cpu" and not self.config.posterior.in_sequence(torso)
        return 1 if is_short else most_devices(self.config.tasks, devices)

    def over(self, axis: str) -> "MetaTraining":
        return replace(self, shared_over=axis)


@jax.jit
def _ahead(learner: MetaTraining, key: Key, theta: DuelingQ) -> tuple[Key, Task, Policy]:
    """What the next iteration collects with, in arrays of its own: the state's are consumed meanwhile."""
    following = jax.random.split(key, 4)[0]
    collect_key, tasks = learner.sample_tasks(following)
    return collect_key, tasks, learner.behaviour(tasks, jax.tree.map(jnp.copy, theta))
