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
from upslope.meta_training.posteriors.posterior import Replays, Samples, repeat_tasks
from upslope.meta_training.state import MetaTrainingState
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import head_class
from upslope.networks.precision import with_precision
from upslope.networks.torsos import torso_class
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Metrics, Scalar, Task


class MetaTraining(AbstractTaskLearner):
    """Algorithm 1. One step is one meta-iteration; the state's ``average`` is the prior.

    Attributes:
        shared_over: the axis of a mesh whose devices share the tasks of each outer gradient; None for one device.
    """

    family: AbstractFamily
    config: MetaTrainingConfig = eqx.field(static=True, default=MetaTrainingConfig())
    shared_over: str | None = eqx.field(static=True, default=None)

    def gather(self, state: MetaTrainingState) -> Replays:
        """Sample a batch of tasks M_i ~ p(T); collect D_i ε-greedily by Q_θ."""
        key, tasks = self.sample_tasks(state.key)
        return self.collect(key, tasks, state.acting)()

    def update(self, state: MetaTrainingState, gathered: Replays) -> tuple[MetaTrainingState, Metrics]:
        """Adapt each φ_i to samples of D_i; update θ by the gradient of its mean distance from the φ_i."""
        adapt, distance = self.config.posterior.adapt, self.config.posterior.distance
        key, _, _, update_key = jax.random.split(state.key, 4)

        def outer_step(carry: tuple[DuelingQ, optax.OptState], key: Key) -> tuple[tuple[DuelingQ, Any], Metrics]:
            theta, optimiser = carry
            samples = self.draw(key, gathered, state.target)
            loss, gradient = meta_gradient(adapt, distance, theta, samples, in_sequence=self.in_sequence)
            return self.descend(theta, optimiser, loss, gradient)

        start, keys = (state.theta, state.optimiser), jax.random.split(update_key, self.config.outer_updates)
        (theta, optimiser), metrics = jax.lax.scan(outer_step, start, keys)
        vital_signs = self.config.posterior.vital_signs(gathered)
        return self.following(state, key, theta, optimiser), vital_signs | jax.tree.map(jnp.mean, metrics)

    def sample_tasks(self, key: Key) -> tuple[Key, Task]:
        """The tasks ``[tasks, ...]`` of the iteration that begins with this key, and a key to collect with."""
        _, task_key, collect_key, _ = jax.random.split(key, 4)
        return collect_key, self.family.sample_many(task_key, self.config.tasks)

    def collect(self, key: Key, tasks: Task, theta: DuelingQ) -> Callable[[], Replays]:
        """Fresh replays D_i ``[tasks, ...]``; the environments take their steps when the result is called."""
        family, posterior = self.family, self.config.posterior
        policy = posterior.policy(theta, family, tasks, self.config.epsilon)
        environments = repeat_tasks(tasks, posterior.environments)
        rollout = family.rollout_later(key, environments, policy, self.config.steps_per_task)
        return lambda: posterior.replays(family, tasks, rollout())

    def draw(self, key: Key, replays: Replays, target: DuelingQ) -> Samples:
        """Samples of every task on this device ``[tasks, ...]``, for the inner and the outer loss alike."""
        keys = jax.random.split(key, self.config.tasks)
        return self.config.posterior.draw(*own_tasks((keys, replays), self.shared_over), target)

    def descend(
        self, theta: DuelingQ, optimiser: optax.OptState, loss: Scalar, gradient: DuelingQ
    ) -> tuple[tuple[DuelingQ, optax.OptState], Metrics]:
        """θ one step of the outer optimiser further, by the mean gradient over all devices."""
        loss, gradient = mean_of_all((loss, gradient), self.shared_over)
        change, optimiser = self.config.optimiser().update(gradient, optimiser)
        metrics = {"outer_loss": loss, "gradient_norm": optax.tree.norm(gradient)}
        return (optax.apply_updates(theta, change), optimiser), metrics

    def following(
        self, state: MetaTrainingState, key: Key, theta: DuelingQ, optimiser: optax.OptState
    ) -> MetaTrainingState:
        """The state after an iteration that ended at θ."""
        return MetaTrainingState(
            key=key,
            trial_key=state.trial_key,
            theta=theta,
            acting=self.family.acting_network(theta, state.theta),
            target=self.config.posterior.next_target(theta, state.target),
            average=optax.incremental_update(theta, state.average, 1 - self.config.averaging),
            optimiser=optimiser,
        )

    @property
    def in_sequence(self) -> bool:
        """Whether tasks are taken one after the other, not side by side."""
        return self.config.posterior.in_sequence(torso_class(self.family.observation_shape))

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
        is_short = jax.default_backend() == "cpu" and not self.in_sequence
        return 1 if is_short else most_devices(self.config.tasks, devices)

    def over(self, axis: str) -> "MetaTraining":
        return replace(self, shared_over=axis)


@jax.jit
def _ahead(learner: MetaTraining, key: Key, theta: DuelingQ) -> tuple[Key, Task, DuelingQ]:
    """What the next iteration collects with, in arrays of its own: the state's are consumed meanwhile."""
    following = jax.random.split(key, 4)[0]
    return *learner.sample_tasks(following), jax.tree.map(jnp.copy, theta)
