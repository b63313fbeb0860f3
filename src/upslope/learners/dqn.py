"""Vanilla DQN, with or without shaping: the learner of Fig. 1, middle, and of Figs. 3 and 5, right."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from upslope.equations.losses import huber, td_error
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.evaluation import greedy_report
from upslope.learners.experience import Experience
from upslope.learners.learner import AbstractTaskLearner, vital_signs
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.learners.settings import AbstractLearnerConfig
from upslope.learners.shaping import Shaping, add_shaping
from upslope.networks.convolution import Precision
from upslope.networks.precision import with_precision
from upslope.networks.q_network import QNetwork
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Metrics, Scalar, Task, Transition


@dataclass(frozen=True)
class DQNConfig(AbstractLearnerConfig):
    """Settings of DQN, the same for every arm of a comparison.

    Attributes:
        hidden: widths of the hidden layers.
        learning_rate: Adam's step size.
        decay_updates: number of updates over which the step size falls linearly to zero; 0 keeps it constant.
        batch_size: transitions per update.
        replay_capacity: transitions that the replay holds.
        warmup_steps: random steps before the first update.
        steps_per_update: environment steps before each update.
        huber_threshold: TD errors count linearly beyond this threshold, instead of squared.
        epsilon: share of random actions.
        target_rate: share of the network that is mixed into the target network at each update.
        evaluation_episodes: greedy episodes that are averaged in each reported return.
        precision: precision of the factors in convolutions; below float32 GPUs are faster, and CPUs only round.
    """

    name: ClassVar[str] = "dqn"
    actions: ClassVar[str] = "discrete"

    hidden: tuple[int, ...] = (32, 32)
    learning_rate: float = 4e-3
    decay_updates: int = 1000
    batch_size: int = 64
    replay_capacity: int = 10_000
    warmup_steps: int = 256
    steps_per_update: int = 1
    huber_threshold: float = 3.0
    epsilon: float = 0.1
    target_rate: float = 0.01
    evaluation_episodes: int = 3
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        check_counts(self, "batch_size", "replay_capacity", "warmup_steps", "steps_per_update", "evaluation_episodes")
        check_shares(epsilon=self.epsilon, target_rate=self.target_rate)

    @classmethod
    def for_recipe(cls, recipe: str) -> "DQNConfig":
        return {"images": for_maps, "maps": for_maps}.get(recipe, cls)()

    def lasting(self, updates: int) -> "DQNConfig":
        return replace(self, decay_updates=self.decay_updates and max(self.decay_updates, updates))

    def build(self, family: AbstractFamily, task: Task, shaping: Shaping | None) -> "DQN":
        self.check_actions(family)
        return DQN(family, task, shaping, self)

    def policy_network(
        self, key: Key, observation_shape: tuple[int, ...], actions: int, observation_scale: tuple[float, ...]
    ) -> QNetwork:
        network = QNetwork(key, observation_shape, actions, self.hidden, observation_scale)
        return with_precision(network, self.precision)

    def acting(self, state: "DQNState") -> QNetwork:
        return state.network


def for_maps() -> DQNConfig:
    """DQN with the paper's convolutional network on grid games (Sec. 5.2).

    ``upslope reproduce grid-learners`` shows the effect of these settings. They are the same for every arm.
    """
    return DQNConfig(
        hidden=(128, 128),
        learning_rate=1e-3,
        decay_updates=0,
        batch_size=16,
        replay_capacity=1000,
        warmup_steps=50,
        steps_per_update=4,
        epsilon=0.3,
        target_rate=0.05,
    )


class DQNState(eqx.Module):
    """Everything that changes during learning."""

    key: Key
    network: QNetwork
    target: QNetwork
    optimiser: optax.OptState
    experience: Experience


class DQN(AbstractTaskLearner):
    """DQN on one task. Rewards are shaped when a batch is used."""

    family: AbstractFamily
    task: Task
    shaping: Shaping | None
    config: DQNConfig = eqx.field(static=True, default=DQNConfig())

    def init(self, key: Key) -> DQNState:
        key, network_key, start_key, warmup_key = jax.random.split(key, 4)
        family = self.family
        network = self.config.policy_network(
            network_key, family.observation_shape, family.actions.count, family.observation_scale
        )
        experience = Experience.start(start_key, self.family, self.task, self.config.replay_capacity, self.shaping)
        experience, _ = experience.extend(
            warmup_key, self.family, self.task, EpsilonGreedy(network, 1.0), self.config.warmup_steps, self.shaping
        )
        return DQNState(key, network, network, self._adam().init(network), experience)

    def gather(self, state: DQNState) -> tuple[Any, Transition]:
        _, act_key, _ = jax.random.split(state.key, 3)
        policy = EpsilonGreedy(state.network, self.config.epsilon)
        return state.experience.act(act_key, self.family, self.task, policy, self.config.steps_per_update)

    def update(self, state: DQNState, gathered: tuple[Any, Transition]) -> tuple[DQNState, Metrics]:
        key, _, sample_key = jax.random.split(state.key, 3)
        running, seen = gathered
        experience = state.experience.remember(running, seen, self.shaping)
        batch = add_shaping(*experience.sample(sample_key, self.config.batch_size))
        loss, gradient = jax.value_and_grad(dqn_loss)(state.network, state.target, batch, self.config.huber_threshold)
        change, optimiser = self._adam().update(gradient, state.optimiser)
        network = optax.apply_updates(state.network, change)
        target = optax.incremental_update(network, state.target, self.config.target_rate)
        metrics = vital_signs(seen) | {
            "td_loss": loss,
            "gradient_norm": optax.tree.norm(gradient),
            "shaped_reward": jnp.mean(batch.reward),
        }
        return DQNState(key, network, target, optimiser, experience), metrics

    def report(self, state: DQNState) -> dict[str, Scalar]:
        key = jax.random.fold_in(state.key, 0)
        policy = Greedy(state.network)
        return greedy_report(key, self.family, self.task, policy, self.config.evaluation_episodes)

    def _adam(self) -> optax.GradientTransformation:
        return adam(self.config.learning_rate, self.config.decay_updates)


def dqn_loss(network: QNetwork, target: QNetwork, batch: Transition, threshold: float) -> Scalar:
    """Mean Huber loss of the TD errors of a batch, bootstrapped with the target network."""
    q, next_value = jax.vmap(network.q)(batch.obs, batch.action), jax.vmap(target.value)(batch.next_obs)
    errors = jax.vmap(td_error)(q, batch.reward, batch.discount, next_value)
    return jnp.mean(jax.vmap(huber, in_axes=(0, None))(errors, threshold))


def adam(learning_rate: float, decay_updates: int) -> optax.GradientTransformation:
    """Adam with a step size that is constant or falls linearly to zero."""
    return optax.adam(optax.linear_schedule(learning_rate, 0.0, decay_updates) if decay_updates else learning_rate)
