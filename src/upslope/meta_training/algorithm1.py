"""Algorithm 1: meta-learning the potential function prior."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Int

from upslope.equations.maml import meta_gradient
from upslope.learners.learner import AbstractTaskLearner
from upslope.learners.policies import Greedy
from upslope.learners.sharing import mean_of_all, most_devices, own_tasks
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.memory import drawn_replays, remember
from upslope.meta_training.posteriors.posterior import Replays, Samples, repeat_tasks
from upslope.meta_training.state import Learned, MetaTrainingState
from upslope.meta_training.statistics import Statistics
from upslope.networks.dueling import DuelingQ
from upslope.networks.heads import head_class
from upslope.networks.precision import with_precision
from upslope.networks.scaling import no_scaling
from upslope.networks.torsos import torso_class
from upslope.tasks.abstract_evaluation import shapes_only
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
        return self.collect(key, tasks, state.acting, state.iteration)()

    def update(self, state: MetaTrainingState, gathered: Replays) -> tuple[MetaTrainingState, Metrics]:
        """Adapt each φ_i to samples of D_i; update θ by the gradient of its mean distance from the φ_i."""
        adapt, distance = self.config.posterior.adapt, self.config.posterior.distance
        key, _, _, update_key = jax.random.split(state.key, 4)
        state = remember(state, gathered, self.config)

        def outer_step(carry: Learned, key: Key) -> tuple[Learned, Metrics]:
            samples = self.draw(key, state, gathered, carry.target)
            loss, gradient = meta_gradient(adapt, distance, carry.theta, samples, in_sequence=self.in_sequence)
            return self.descend(carry, loss, gradient)

        start, keys = Learned.of(state), jax.random.split(update_key, self.config.outer_updates)
        learned, metrics = jax.lax.scan(outer_step, start, keys)
        vital_signs = self.config.posterior.vital_signs(gathered)
        return self.following(state, key, learned), vital_signs | jax.tree.map(jnp.mean, metrics)

    def sample_tasks(self, key: Key) -> tuple[Key, Task]:
        """The tasks ``[tasks, ...]`` of the iteration that begins with this key, and a key to collect with."""
        _, task_key, collect_key, _ = jax.random.split(key, 4)
        return collect_key, self.family.sample_many(task_key, self.config.tasks)

    def collect(self, key: Key, tasks: Task, theta: DuelingQ, iteration: Int[Array, ""]) -> Callable[[], Replays]:
        """Fresh replays D_i ``[tasks, ...]``; the environments take their steps when the result is called."""
        family, posterior = self.family, self.config.posterior
        policy = posterior.policy(theta, family, tasks, self.config.epsilon, self.config.explorer(iteration))
        environments = repeat_tasks(tasks, posterior.environments)
        rollout = family.rollout_later(key, environments, policy, self.config.steps_per_task)
        return lambda: posterior.replays(family, tasks, rollout())

    def draw(self, key: Key, state: MetaTrainingState, gathered: Replays, target: DuelingQ) -> Samples:
        """Samples of every task on this device ``[tasks, ...]``, for the inner and the outer loss alike."""
        keys, replays = jax.random.split(key, self.config.tasks), gathered
        if state.kept is not None:
            draw_key, choice_key = jax.random.split(key)
            keys = jax.random.split(draw_key, self.config.tasks)
            replays = drawn_replays(choice_key, state, self.config)
        return self.config.posterior.draw(*own_tasks((keys, replays), self.shared_over), target)

    def descend(self, learned: Learned, loss: Scalar, gradient: DuelingQ) -> tuple[Learned, Metrics]:
        """θ one step of the outer optimiser further, by the mean gradient over all devices."""
        loss, gradient = mean_of_all((loss, gradient), self.shared_over)
        change, optimiser = self.config.optimiser().update(gradient, learned.optimiser)
        metrics = {"outer_loss": loss, "gradient_norm": optax.tree.norm(gradient)}
        theta = optax.apply_updates(learned.theta, change)
        return Learned(theta, optimiser, self.config.posterior.moved_target(theta, learned.target)), metrics

    def following(self, state: MetaTrainingState, key: Key, learned: Learned) -> MetaTrainingState:
        """The state after an iteration that ended at θ."""
        theta = learned.theta
        return MetaTrainingState(
            key=key,
            trial_key=state.trial_key,
            theta=theta,
            acting=self.family.acting_network(theta, state.theta),
            target=self.config.posterior.next_target(theta, learned.target),
            average=optax.incremental_update(theta, state.average, 1 - self.config.averaging),
            optimiser=learned.optimiser,
            iteration=state.iteration + 1,
            kept=state.kept,
            statistics=state.statistics,
        )

    @property
    def in_sequence(self) -> bool:
        """Whether tasks are taken one after the other, not side by side."""
        return self.config.posterior.in_sequence(torso_class(self.family.observation_shape))

    def gather_ahead(self, state: MetaTrainingState) -> Callable[[], Replays]:
        key, tasks, theta = _ahead(self, state.key, state.theta)
        return self.collect(key, tasks, theta, state.iteration + 1)

    def init(self, key: Key) -> MetaTrainingState:
        """θ with random weights.

        Raises:
            UpslopeError: a family that the posterior does not fit, or whose actions no head fits.
        """
        key, trial_key, network_key = jax.random.split(key, 3)
        family, config = self.family, self.config
        config.posterior.check(family)
        inputs = family.observation_shape[-1]
        theta = DuelingQ(
            network_key,
            family.observation_shape,
            family.actions.count,
            config.hidden,
            (1.0,) * inputs if config.normalise else family.observation_scale,
            config.activation,
            head_class(config.head, family.actions.kind),
            no_scaling(inputs) if config.normalise else None,
        )
        theta = with_precision(theta, config.precision)
        return MetaTrainingState(
            key,
            trial_key,
            theta,
            theta,
            theta,
            theta,
            config.optimiser().init(theta),
            jnp.zeros((), jnp.int32),
            self._room_for_replays(theta),
            Statistics.none(inputs) if config.normalise else None,
        )

    def _room_for_replays(self, theta: DuelingQ) -> Replays | None:
        """Replays of zeros, of as many iterations as are kept; None if that is one."""
        if self.config.kept_iterations == 1:
            return None
        with shapes_only():
            shapes = jax.eval_shape(
                lambda key: self.collect(*self.sample_tasks(key), theta, jnp.zeros((), jnp.int32))(), jax.random.key(0)
            )
        kept = self.config.kept_iterations
        return jax.tree.map(lambda leaf: jnp.zeros((kept * leaf.shape[0], *leaf.shape[1:]), leaf.dtype), shapes)

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
