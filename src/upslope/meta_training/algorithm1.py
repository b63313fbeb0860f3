"""Algorithm 1: meta-learning the potential function prior."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from upslope.equations.losses import prior_learning_loss, td_loss
from upslope.equations.maml import adapt, gradient_task_by_task
from upslope.errors import UpslopeError
from upslope.learners.learner import AbstractTaskLearner, in_turn, vital_signs
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.learners.replay import Replay
from upslope.learners.sharing import mean_of_all, most_devices, own_tasks
from upslope.meta_training.finite_posterior import FiniteSamples, collect_steps, outer_loss_in_all_states, q_tables
from upslope.meta_training.recipes import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ, with_convolutions
from upslope.tasks.family import AbstractFamily
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Key, Metrics, Scalar, Transition


class MetaTrainingState(eqx.Module):
    """All that changes while meta-training.

    Attributes:
        theta: θ.
        acting: θ one iteration ago, which acts on the host, where environments take their steps while gradients are
            computed; None with compiled environments, where θ itself acts.
        target: the averaged network of the inner TD target.
        average: moving average of θ: the prior.
        trial_key: draws the extra training tasks; the same for every snapshot, so that they compare.
    """

    key: Key
    trial_key: Key
    theta: DuelingQ
    target: DuelingQ
    average: DuelingQ
    optimiser: optax.OptState
    acting: DuelingQ | None = None


class TaskSamples(eqx.Module):
    """What one φ_i and its outer loss are computed from: a batch of one task, and the inner TD targets' network."""

    batch: Transition
    next_q: Float[Array, "*tasks batch actions"] | None


class MetaTraining(AbstractTaskLearner):
    """Algorithm 1. One step is one meta-iteration; the state's ``average`` is the prior.

    Attributes:
        shared_over: the axis of a mesh whose devices share the tasks of each outer gradient; None for one device.
    """

    family: AbstractFamily
    config: MetaTrainingConfig = eqx.field(static=True, default=MetaTrainingConfig())
    shared_over: str | None = eqx.field(static=True, default=None)

    def most_devices(self, devices: int) -> int:
        # Cores of one CPU wait for each other at each outer step, and all gather: long tasks alone are worth it.
        short = jax.default_backend() == "cpu" and not (self.config.task_by_task and in_turn(self))
        return 1 if short else most_devices(self.config.tasks, devices)

    def over(self, axis: str) -> "MetaTraining":
        return replace(self, shared_over=axis)

    def init(self, key: Key) -> MetaTrainingState:
        key, trial_key, network_key = jax.random.split(key, 3)
        family, config = self.family, self.config
        if family.actions.kind == "continuous":
            raise UpslopeError(
                f"{family.name} tasks have continuous actions, of which Algorithm 1 has no Q: meta-train on a family "
                "with discrete ones and the same observations; its V shapes the rewards of any learner."
            )
        if config.posterior != "network" and not family.lists_states:
            raise UpslopeError(f'{family.name} tasks are not finite, as that needs: set posterior="network".')
        theta = DuelingQ(
            network_key,
            family.observation_shape,
            family.actions.count,
            config.hidden,
            family.observation_scale,
            config.activation,
        )
        theta = with_convolutions(theta, config.precision)
        acting = theta if self.family.engine == "host" else None
        return MetaTrainingState(key, trial_key, theta, theta, theta, self._optimiser().init(theta), acting)

    def gather(self, state: MetaTrainingState) -> Transition | FiniteSamples:
        key, tasks = self.tasks(state.key)
        return self.collect(key, tasks, state.theta if state.acting is None else state.acting)

    def tasks(self, key: Key) -> tuple[Key, Any]:
        """What an iteration that begins with this key collects with: a key, and tasks ``[tasks, ...]``."""
        _, task_key, collect_key, _ = jax.random.split(key, 4)
        return collect_key, self.family.sample_many(task_key, self.config.tasks)

    def gather_ahead(self, state: MetaTrainingState) -> Callable[[], Transition | FiniteSamples] | None:
        if state.acting is None:
            return None
        key, tasks, policy = _drawn_ahead(self, state.key, state.theta)
        return self.family.rollout_later(key, tasks, policy, self.config.steps_per_task)

    def update(
        self, state: MetaTrainingState, gathered: Transition | FiniteSamples
    ) -> tuple[MetaTrainingState, Metrics]:
        key, _, _, update_key = jax.random.split(state.key, 4)

        own = own_tasks(gathered, self.shared_over)

        def outer_step(carry: tuple[DuelingQ, Any], key: Key) -> tuple[tuple[DuelingQ, Any], Metrics]:
            theta, optimiser = carry
            loss, gradient = self.outer_gradient(theta, self.draw(key, own, state.target))
            loss, gradient = mean_of_all((loss, gradient), self.shared_over)
            change, optimiser = self._optimiser().update(gradient, optimiser)
            metrics = {"outer_loss": loss, "gradient_norm": optax.tree.norm(gradient)}
            return (optax.apply_updates(theta, change), optimiser), metrics

        keys = jax.random.split(update_key, self.config.outer_updates)
        (theta, optimiser), metrics = jax.lax.scan(outer_step, (state.theta, state.optimiser), keys)
        following = MetaTrainingState(
            key,
            state.trial_key,
            theta,
            self._target(theta, state.target),
            self._average(theta, state.average),
            optimiser,
            None if state.acting is None else state.theta,
        )
        if isinstance(gathered, FiniteSamples):
            signs = {"reward": jnp.mean(gathered.steps.reward, axis=-1)}
        else:
            signs = vital_signs(gathered)
        return following, signs | jax.tree.map(jnp.mean, metrics)

    def collect(self, key: Key, tasks: Any, theta: DuelingQ) -> Transition | FiniteSamples:
        """Fresh replays D_i ``[tasks, steps, ...]``, ε-greedy by Q_θ, with its own ε for each task or environment."""
        if self.config.posterior != "network":
            assert isinstance(self.family, JaxTasks), "init refuses all others"
            epsilon = jnp.linspace(*self.config.epsilon, self.config.environments)
            return collect_steps(key, self.family, tasks, theta, epsilon, self.config.steps_per_task)
        return self.family.rollout(key, tasks, self.behaviour(theta), self.config.steps_per_task)

    def behaviour(self, theta: DuelingQ) -> EpsilonGreedy:
        """What acts on a batch of tasks, with an ε for each."""
        return EpsilonGreedy(theta, jnp.linspace(*self.config.epsilon, self.config.tasks))

    def draw(self, key: Key, experience: Transition | FiniteSamples, target: DuelingQ) -> TaskSamples | FiniteSamples:
        """The samples of every task here ``[tasks, batch, ...]``, used by the inner and the outer loss alike."""
        if isinstance(experience, FiniteSamples):
            base = None if self.config.target_decay is None else q_tables(target, experience.observations)
            return FiniteSamples(experience.observations, experience.steps, base)
        keys = own_tasks(jax.random.split(key, self.config.tasks), self.shared_over)
        batch = jax.vmap(lambda key, data: Replay.of(data).sample(key, self.config.batch_size))(keys, experience)
        if self.config.target_decay is None:
            return TaskSamples(batch, None)
        return TaskSamples(batch, jax.vmap(jax.vmap(target))(batch.next_obs))

    def outer_gradient(self, theta: DuelingQ, samples: TaskSamples | FiniteSamples) -> tuple[Scalar, DuelingQ]:
        """The outer loss and its gradient, all tasks at once or one after the other."""
        if self.config.task_by_task:
            return gradient_task_by_task(self.task_outer_loss, theta, samples)
        return jax.value_and_grad(self.outer_loss)(theta, samples)

    def outer_loss(self, theta: DuelingQ, samples: TaskSamples | FiniteSamples) -> Scalar:
        """Mean of `task_outer_loss` over tasks."""
        return jnp.mean(jax.vmap(lambda task: self.task_outer_loss(theta, task))(samples))

    def task_outer_loss(self, theta: DuelingQ, samples: TaskSamples | FiniteSamples) -> Scalar:
        """Eq. 7 for one task, with φ_i adapted from θ by Eq. 2 on the TD error of Eq. 5."""
        config = self.config
        if isinstance(samples, FiniteSamples):
            return outer_loss_in_all_states(theta, samples, config)
        how = {"first_order": config.first_order, "rematerialise": config.rematerialise}
        phi = adapt(self.task_td_loss, theta, samples, **config.inner, **how)
        return self.distance_to_posterior(theta, phi, samples)

    def task_td_loss(self, network: DuelingQ, samples: TaskSamples) -> Scalar:
        """Mean of Eq. 5 over one task's batch."""
        batch = samples.batch
        next_q = jax.vmap(network)(batch.next_obs) if samples.next_q is None else samples.next_q
        if self.config.td_gradient == "semi":
            next_q = jax.lax.stop_gradient(next_q)
        q = jax.vmap(network)(batch.obs)
        return jnp.mean(jax.vmap(td_loss)(q, batch.action, batch.reward, batch.discount, next_q))

    def distance_to_posterior(self, theta: DuelingQ, phi: DuelingQ, samples: TaskSamples) -> Scalar:
        """Mean of Eq. 7 over one task's batch."""
        q_prior, q_posterior = jax.vmap(theta)(samples.batch.obs), jax.vmap(phi)(samples.batch.obs)
        if self.config.outer_target == "stopped":
            # Kept, the loss falls fastest by shrinking the tangent kernel: features die and V goes flat.
            q_posterior = jax.lax.stop_gradient(q_posterior)
        return jnp.mean(jax.vmap(prior_learning_loss)(q_prior, q_posterior, samples.batch.action))

    def report(self, state: MetaTrainingState) -> dict[str, Any]:
        """The prior as it stands, and its mean greedy return on extra training tasks."""
        task_key, episode_key = jax.random.split(state.trial_key)
        tasks = self.family.sample_many(task_key, self.config.evaluation_tasks)
        tasks = jax.tree.map(lambda leaf: jnp.repeat(leaf, self.config.evaluation_episodes, axis=0), tasks)
        returns = self.family.returns(episode_key, tasks, Greedy(state.average))
        return {"return": jnp.mean(returns), "prior": state.average}

    def _optimiser(self) -> optax.GradientTransformation:
        config = self.config
        updates = config.iterations * config.outer_updates - config.outer_warmup
        schedule = optax.linear_schedule(config.outer_step_size, config.outer_step_size_end, max(updates, 1))
        if config.outer_warmup:
            rise = optax.linear_schedule(0.0, config.outer_step_size, config.outer_warmup)
            schedule = optax.join_schedules([rise, schedule], [config.outer_warmup])
        return optax.adam(schedule) if config.outer_optimiser == "adam" else optax.sgd(schedule)

    def _target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        if self.config.target_decay is None:
            return theta
        return optax.incremental_update(theta, target, 1 - self.config.target_decay)

    def _average(self, theta: DuelingQ, average: DuelingQ) -> DuelingQ:
        return optax.incremental_update(theta, average, 1 - self.config.averaging)


@jax.jit
def _drawn_ahead(learner: MetaTraining, key: Key, theta: DuelingQ) -> tuple[Key, Any, EpsilonGreedy]:
    """What the next iteration's `MetaTraining.collect` is given, in arrays of its own."""
    following = jax.random.split(key, 4)[0]
    return *learner.tasks(following), learner.behaviour(jax.tree.map(jnp.copy, theta))
