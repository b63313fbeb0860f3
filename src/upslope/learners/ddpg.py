"""DDPG for continuous actions, with or without shaping: the learner of Fig. 1, right."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from upslope.equations.losses import huber, td_error
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.dqn import adam
from upslope.learners.experience import Experience, greedy_return
from upslope.learners.learner import AbstractTaskLearner, vital_signs
from upslope.learners.policies import Greedy, Noisy
from upslope.learners.settings import AbstractLearnerConfig
from upslope.learners.shaping import Shaping, add_shaping
from upslope.networks.actor_critic import Actor, Critic
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Metrics, Scalar, Task, Transition


@dataclass(frozen=True)
class DDPGConfig(AbstractLearnerConfig):
    """Settings of DDPG, the same for every arm of a comparison.

    Attributes:
        hidden: widths of the hidden layers of both networks.
        learning_rate: Adam's step size for both networks.
        decay_updates: number of updates over which the step size falls linearly to zero; 0 keeps it constant.
        batch_size: transitions per update.
        replay_capacity: transitions that the replay holds.
        warmup_steps: steps of the untrained noisy policy before the first update.
        steps_per_update: environment steps before each update.
        huber_threshold: the critic's TD errors count linearly beyond this threshold, instead of squared.
        noise: standard deviation of the exploration noise, as a share of the largest action.
        target_rate: share of the networks that is mixed into the target networks at each update.
        saturation_penalty: weight of the squared tanh pre-activation in the actor's loss; it prevents saturation.
        evaluation_episodes: episodes without noise that are averaged in each reported return.
    """

    name: ClassVar[str] = "ddpg"
    actions: ClassVar[str] = "continuous"

    hidden: tuple[int, ...] = (32, 32)
    learning_rate: float = 1.5e-3
    decay_updates: int = 3000
    batch_size: int = 64
    replay_capacity: int = 10_000
    warmup_steps: int = 256
    steps_per_update: int = 1
    huber_threshold: float = 3.0
    noise: float = 0.3
    target_rate: float = 0.003
    saturation_penalty: float = 0.03
    evaluation_episodes: int = 3

    def __post_init__(self) -> None:
        check_counts(self, "batch_size", "replay_capacity", "warmup_steps", "steps_per_update", "evaluation_episodes")
        check_shares(target_rate=self.target_rate)

    @classmethod
    def for_recipe(cls, recipe: str) -> "DDPGConfig":
        del recipe  # the settings are the same for all recipes
        return cls()

    def lasting(self, updates: int) -> "DDPGConfig":
        return replace(self, decay_updates=self.decay_updates and max(self.decay_updates, updates))

    def build(self, family: AbstractFamily, task: Task, shaping: Shaping | None) -> "DDPG":
        self.check_actions(family)
        return DDPG(family, task, shaping, self)

    def policy_network(
        self, key: Key, observation_shape: tuple[int, ...], actions: int, observation_scale: tuple[float, ...]
    ) -> Actor:
        return Actor(key, observation_shape, actions, self.hidden, observation_scale)

    def acting(self, state: "DDPGState") -> Actor:
        return state.actor


class DDPGState(eqx.Module):
    """Everything that changes during learning."""

    key: Key
    actor: Actor
    critic: Critic
    target_actor: Actor
    target_critic: Critic
    optimisers: tuple[optax.OptState, optax.OptState]
    experience: Experience


class DDPG(AbstractTaskLearner):
    """DDPG on one task. Rewards are shaped when a batch is used."""

    family: AbstractFamily
    task: Task
    shaping: Shaping | None
    config: DDPGConfig = eqx.field(static=True, default=DDPGConfig())

    def init(self, key: Key) -> DDPGState:
        key, actor_key, critic_key, start_key, warmup_key = jax.random.split(key, 5)
        family, config = self.family, self.config
        sizes = (family.observation_shape, family.actions.count, config.hidden, family.observation_scale)
        actor, critic = Actor(actor_key, *sizes), Critic(critic_key, *sizes)
        experience = Experience.start(start_key, family, self.task, config.replay_capacity, self.shaping)
        experience, _ = experience.extend(
            warmup_key, family, self.task, Noisy(actor, config.noise), config.warmup_steps, self.shaping
        )
        optimisers = (self._adam().init(actor), self._adam().init(critic))
        return DDPGState(key, actor, critic, actor, critic, optimisers, experience)

    def gather(self, state: DDPGState) -> tuple[Any, Transition]:
        _, act_key, _ = jax.random.split(state.key, 3)
        policy = Noisy(state.actor, self.config.noise)
        return state.experience.act(act_key, self.family, self.task, policy, self.config.steps_per_update)

    def update(self, state: DDPGState, gathered: tuple[Any, Transition]) -> tuple[DDPGState, Metrics]:
        key, _, sample_key = jax.random.split(state.key, 3)
        config = self.config
        running, seen = gathered
        experience = state.experience.remember(running, seen, self.shaping)
        batch = add_shaping(*experience.sample(sample_key, config.batch_size))

        critic_objective, critic_gradient = jax.value_and_grad(critic_loss)(
            state.critic, state.target_actor, state.target_critic, batch, config.huber_threshold
        )
        change, critic_optimiser = self._adam().update(critic_gradient, state.optimisers[1])
        critic = optax.apply_updates(state.critic, change)

        actor_objective, actor_gradient = jax.value_and_grad(actor_loss)(
            state.actor, critic, batch, config.saturation_penalty
        )
        change, actor_optimiser = self._adam().update(actor_gradient, state.optimisers[0])
        actor = optax.apply_updates(state.actor, change)

        following = DDPGState(
            key,
            actor,
            critic,
            optax.incremental_update(actor, state.target_actor, config.target_rate),
            optax.incremental_update(critic, state.target_critic, config.target_rate),
            (actor_optimiser, critic_optimiser),
            experience,
        )
        metrics = vital_signs(seen) | {
            "critic_loss": critic_objective,
            "actor_loss": actor_objective,
            "gradient_norm": optax.tree.norm((actor_gradient, critic_gradient)),
            "shaped_reward": jnp.mean(batch.reward),
        }
        return following, metrics

    def report(self, state: DDPGState) -> dict[str, Scalar]:
        key = jax.random.fold_in(state.key, 0)
        policy = Greedy(state.actor)
        return {"return": greedy_return(key, self.family, self.task, policy, self.config.evaluation_episodes)}

    def _adam(self) -> optax.GradientTransformation:
        return adam(self.config.learning_rate, self.config.decay_updates)


def critic_loss(
    critic: Critic, target_actor: Actor, target_critic: Critic, batch: Transition, threshold: float
) -> Scalar:
    """Mean Huber loss of the critic's TD errors, bootstrapped with the target networks."""
    next_value = jax.vmap(target_critic)(batch.next_obs, jax.vmap(target_actor.best)(batch.next_obs))
    q = jax.vmap(critic)(batch.obs, batch.action)
    errors = jax.vmap(td_error)(q, batch.reward, batch.discount, next_value)
    return jnp.mean(jax.vmap(huber, in_axes=(0, None))(errors, threshold))


def actor_loss(actor: Actor, critic: Critic, batch: Transition, saturation_penalty: float) -> Scalar:
    """Minus the critic's mean value of the actor's actions, plus a penalty that keeps the tanh from saturating."""
    pre_activation = jax.vmap(actor.pre_activation)(batch.obs)
    q = jax.vmap(critic)(batch.obs, jnp.tanh(pre_activation))
    return -jnp.mean(q) + saturation_penalty * jnp.mean(pre_activation**2)
