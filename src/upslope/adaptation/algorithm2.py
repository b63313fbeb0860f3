"""Algorithm 2: adapts prior and policy together to a new task, first the A head, then the V head."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from upslope.equations.losses import advantage_loss, value_loss
from upslope.equations.maml import descend
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.evaluation import greedy_report
from upslope.learners.experience import Experience
from upslope.learners.learner import AbstractTaskLearner, vital_signs
from upslope.learners.lookups import dueling_table
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.learners.shaping import add_shaping, potential_based
from upslope.networks.dueling import AbstractDueling, ByAdvantage, DuelingQ
from upslope.tasks.family import AbstractFamily
from upslope.types import Action, Key, Metrics, Observation, Scalar, Task, Transition


@runtime_checkable
class UpdateRule(Protocol):
    """How an arm computes new parameters from a batch: Algorithm 2, MAML, or one of the controls between them."""

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        """φ after one update on raw transitions ``[n, ...]``. The prior is evaluated but not updated."""
        ...


class Algorithm2(eqx.Module):
    """The two steps of Algorithm 2: A by Eq. 8 with the current potential, then V by Eq. 9.

    Attributes:
        centred: whether to subtract the *prior's* fixed max A, so that A starts as Q_θ − V_θ. Training by Eq. 6 leaves
            the level of the raw A head arbitrary, and the first V steps would have to undo it. Subtracting the
            *current* max instead would make Eq. 9's gradient identically zero.
        value_step: the step size of Eq. 9 divided by that of Eq. 8; 1 in the paper. With tables, equal steps diverge on
            some maps, and a ratio of 0.1 on none (docs/theorems.md).
    """

    centred: bool = eqx.field(static=True, default=True)
    value_step: float = eqx.field(static=True, default=1.0)

    def update(self, phi: DuelingQ, prior: AbstractDueling, batch: Transition, step_size: Scalar) -> DuelingQ:
        level = self.level(prior)
        phi = descend(phi, jax.grad(advantage_step_loss)(phi, phi, batch, level), step_size)
        return descend(phi, jax.grad(value_step_loss)(phi, batch, level), self.value_step * step_size)

    def level(self, prior: AbstractDueling) -> Callable[[Observation], Scalar]:
        """The function of s that is subtracted from A(s, ·)."""
        return prior.highest_advantage if self.centred else (lambda obs: jnp.zeros(()))


def advantage_step_loss(
    phi: DuelingQ, potential: AbstractDueling, batch: Transition, level: Callable[[Observation], Scalar]
) -> Scalar:
    """Mean of Eq. 8 with rewards shaped by the V head of ``potential``, which is constant here."""
    shaped = add_shaping(batch, potential_based(jax.lax.stop_gradient(potential).value).rewards(batch))

    def loss(obs: Observation, action: Action, reward: Scalar, discount: Scalar, next_obs: Observation) -> Scalar:
        highest_next = jax.lax.stop_gradient(phi.highest_advantage(next_obs) - level(next_obs))
        return advantage_loss(phi.advantage(obs, action) - level(obs), reward, discount, highest_next)

    return jnp.mean(jax.vmap(loss)(*shaped))


def value_step_loss(phi: DuelingQ, batch: Transition, level: Callable[[Observation], Scalar]) -> Scalar:
    """Mean of Eq. 9."""

    def loss(obs: Observation) -> Scalar:
        return value_loss(phi.value(obs), jax.lax.stop_gradient(phi).highest_advantage(obs) - level(obs))

    return jnp.mean(jax.vmap(loss)(batch.obs))


@dataclass(frozen=True)
class AdaptationConfig:
    """Settings of adaptation, the same for every arm.

    Attributes:
        batch_size: transitions per gradient.
        replay_capacity: transitions that the replay holds.
        steps_per_update: environment steps before each update.
        epsilon: share of random actions.
        evaluation_episodes: greedy episodes that are averaged in each reported return.
    """

    batch_size: int = 128
    replay_capacity: int = 10_000
    steps_per_update: int = 200
    epsilon: float = 0.1
    evaluation_episodes: int = 3

    def __post_init__(self) -> None:
        check_counts(self, "batch_size", "replay_capacity", "steps_per_update", "evaluation_episodes")
        check_shares(epsilon=self.epsilon)


def for_maps() -> AdaptationConfig:
    """Adaptation with the convolutional network on grid games: one episode of full length before each update."""
    return AdaptationConfig(batch_size=32, replay_capacity=1000, steps_per_update=50)


class AdaptationState(eqx.Module):
    """Everything that changes during adaptation.

    Attributes:
        phi: φ_j, the task-posterior.
        evaluated: φ for acting and reports, which need no gradient. In finite tasks it is a table of all states, which
            saves a third of an update's passes through the network; in other tasks it is φ itself.
        prior: θ, likewise.
    """

    key: Key
    phi: DuelingQ
    experience: Experience
    evaluated: AbstractDueling
    prior: AbstractDueling


class Adaptation(AbstractTaskLearner):
    """Few-shot learning of one task from a prior, by one of the update rules.

    The policy follows the A head for every rule: Eq. 6's Q has its maximum at the same action.

    Attributes:
        prior: θ, the start of φ.
        step_size: α of plain gradient descent.
    """

    family: AbstractFamily
    task: Task
    prior: DuelingQ
    step_size: Float[Array, "*batch"]
    rule: UpdateRule = Algorithm2()
    config: AdaptationConfig = eqx.field(static=True, default=AdaptationConfig())

    def init(self, key: Key) -> AdaptationState:
        key, start_key = jax.random.split(key)
        experience = Experience.start(start_key, self.family, self.task, self.config.replay_capacity)
        prior = dueling_table(self.family, self.task, self.prior)
        return AdaptationState(key, self.prior, experience, prior, prior)

    def gather(self, state: AdaptationState) -> tuple[Any, Transition]:
        _, act_key, _ = jax.random.split(state.key, 3)
        policy = EpsilonGreedy(ByAdvantage(state.evaluated), self.config.epsilon)
        return state.experience.act(act_key, self.family, self.task, policy, self.config.steps_per_update)

    def update(self, state: AdaptationState, gathered: tuple[Any, Transition]) -> tuple[AdaptationState, Metrics]:
        key, _, sample_key = jax.random.split(state.key, 3)
        running, seen = gathered
        experience = state.experience.remember(running, seen)
        batch = experience.sample(sample_key, self.config.batch_size).transition
        phi = self.rule.update(state.phi, state.prior, batch, self.step_size)
        evaluated = dueling_table(self.family, self.task, phi)
        change = jnp.mean(jnp.abs(jax.vmap(evaluated.value)(batch.obs) - jax.vmap(state.prior.value)(batch.obs)))
        state = AdaptationState(key, phi, experience, evaluated, state.prior)
        return state, vital_signs(seen) | {"value_change": change}

    def report(self, state: AdaptationState) -> dict[str, Scalar]:
        key = jax.random.fold_in(state.key, 0)
        policy = Greedy(ByAdvantage(state.evaluated))
        return greedy_report(key, self.family, self.task, policy, self.config.evaluation_episodes)
