"""φ_i is the whole network, adapted to a batch of its task's replay: the paper's reading, for every family."""

from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from upslope.equations.losses import prior_learning_loss, td_loss
from upslope.equations.maml import adapt
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.learner import vital_signs
from upslope.learners.replay import Replay
from upslope.meta_training.posteriors.posterior import AbstractPosterior, Explorer, Name, spaced
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso
from upslope.tasks.family import AbstractFamily
from upslope.types import Keys, Metrics, Policy, Scalar, Task, Transition


class TaskBatch(eqx.Module):
    """A batch of one task, or of several, and V of the successors by the target network, if there is one."""

    transitions: Transition
    next_value: Float[Array, "*tasks batch"] | None


@dataclass(frozen=True)
class NetworkPosterior(AbstractPosterior):
    """φ_i is the whole network.

    Attributes:
        batch_size: samples of each task for its φ_i; the outer loss uses the same ones.
        inner_step_size: α, the size of an inner step.
        inner_steps: N, the number of inner steps.
        normalised_steps: use Polyak's steps: α is the share of a single squared error that one step removes.
        outer_target: whether gradients flow through Q_φ as the target of Eq. 7: "kept" (the literal reading, which
            collapses) or "stopped".
        first_order: with a kept target, leave out second derivatives through φ(θ).
        rematerialise: with a kept target, compute each inner step again when differentiating instead of storing its
            intermediate results: the same numbers in less memory and more time.
        td_gradient: "semi" (TD targets are constants) or "full" (Eq. 5 differentiated on both sides).
        target_decay: decay per iteration of the averaged network in the inner TD target; None for no such network.
        task_by_task: take the tasks' gradients one after the other instead of side by side: the same numbers in less
            memory. None chooses what is faster for the network.
    """

    name: Name = field(default="network", init=False)

    batch_size: int = 64
    inner_step_size: float = 0.01
    inner_steps: int = 1
    normalised_steps: bool = False
    outer_target: Literal["stopped", "kept"] = "stopped"
    first_order: bool = False
    rematerialise: bool = False
    td_gradient: Literal["semi", "full"] = "semi"
    target_decay: float | None = 0.9
    task_by_task: bool | None = None

    def __post_init__(self) -> None:
        check_counts(self, "batch_size", "inner_steps")
        check_shares(target_decay=self.target_decay or 0.0)

    @property
    def environments(self) -> int:
        return 1

    def check(self, family: AbstractFamily) -> None:
        """Every family will do."""

    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        return torso.takes_turns if self.task_by_task is None else self.task_by_task

    def policy(
        self, theta: DuelingQ, family: AbstractFamily, tasks: Task, epsilon: tuple[float, float], explorer: Explorer
    ) -> Policy:
        del family
        return explorer(theta, spaced(epsilon, len(jax.tree.leaves(tasks)[0])))

    def replays(self, family: AbstractFamily, tasks: Task, transitions: Transition) -> Transition:
        del family, tasks
        return transitions

    def vital_signs(self, replays: Transition) -> Metrics:
        return vital_signs(replays)

    def draw(self, keys: Keys, replays: Transition, target: DuelingQ) -> TaskBatch:
        batch = jax.vmap(lambda key, data: Replay.of(data).sample(key, self.batch_size))(keys, replays)
        if self.target_decay is None:
            return TaskBatch(batch, None)
        return TaskBatch(batch, jax.vmap(jax.vmap(target.value))(batch.next_obs))

    def adapt(self, theta: DuelingQ, samples: TaskBatch) -> DuelingQ:
        return adapt(
            self.td_loss,
            theta,
            samples,
            step_size=self.inner_step_size,
            steps=self.inner_steps,
            normalised=self.normalised_steps,
            first_order=self.first_order,
            rematerialise=self.rematerialise,
        )

    def td_loss(self, network: DuelingQ, samples: TaskBatch) -> Scalar:
        """Mean of Eq. 5 over one task's batch."""
        batch = samples.transitions
        next_value = jax.vmap(network.value)(batch.next_obs) if samples.next_value is None else samples.next_value
        if self.td_gradient == "semi":
            next_value = jax.lax.stop_gradient(next_value)
        q = jax.vmap(network.q)(batch.obs, batch.action)
        return jnp.mean(jax.vmap(td_loss)(q, batch.reward, batch.discount, next_value))

    def distance(self, theta: DuelingQ, phi: DuelingQ, samples: TaskBatch) -> Scalar:
        batch = samples.transitions
        q_prior, q_posterior = (jax.vmap(network.q)(batch.obs, batch.action) for network in (theta, phi))
        if self.outer_target == "stopped":
            # Kept, the loss falls fastest by shrinking the tangent kernel: features die and V goes flat.
            q_posterior = jax.lax.stop_gradient(q_posterior)
        return jnp.mean(prior_learning_loss(q_prior, q_posterior))

    def next_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        if self.target_decay is None:
            return theta
        return optax.incremental_update(theta, target, 1 - self.target_decay)
