"""φ_i is a table of Q along the trajectories of D_i, solved by Bellman backups from the target network."""

from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int

from upslope.equations.losses import huber, prior_learning_loss, td_loss
from upslope.equations.maml import adapt
from upslope.learners.checks import check_counts, check_shares
from upslope.learners.learner import vital_signs
from upslope.meta_training.posteriors.posterior import AbstractPosterior, Explorer, Name, spaced
from upslope.meta_training.statistics import joined
from upslope.networks.dueling import DuelingQ
from upslope.networks.torso import AbstractTorso
from upslope.tasks.family import AbstractFamily
from upslope.types import Key, Keys, Metrics, Policy, Scalar, Task, Transition

Steps = Float[Array, "*rows steps"]


class Trajectories(eqx.Module):
    """D_i of one task, or of several, and what the target network says of it.

    Attributes:
        transitions: ``[*tasks, environments, steps, ...]``.
        start: Q of each step's action, from which the table starts.
        next_value: V of each successor.
        next_other: the highest Q of each successor over all actions but the one taken there; None if N = 1.
        joined: whether the successor is what the next step begins with; None if N = 1.
    """

    transitions: Transition
    start: Steps
    next_value: Steps
    next_other: Steps | None
    joined: Bool[Array, "*rows steps"] | None


@dataclass(frozen=True)
class TrajectoryPosterior(AbstractPosterior):
    """φ_i is a table with one entry for each step of D_i, so that it fits every family, and costs next to nothing.

    With N = 1 and α = 1 the table is one Bellman backup of the target network, and Eq. 7 is the loss of multi-task
    Q-learning. With more steps, rewards travel back along the trajectories.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the share of each TD error that one step removes.
        inner_steps: N, the number of inner steps.
        outer_loss: Eq. 7 as printed ("squared"), or "huber", whose bounded gradient loses to a V that climbs around
            rare rewards (docs/deviations.md).
        target_decay: decay per outer step of the averaged network that values successors.
        drawn_steps: an outer step draws so many steps of each trajectory, in one piece; None draws whole ones.
    """

    name: Name = field(default="trajectories", init=False)

    environments: int = 4
    inner_step_size: float = 1.0
    inner_steps: int = 1
    outer_loss: Literal["squared", "huber"] = "squared"
    target_decay: float = 0.98
    drawn_steps: int | None = None

    def __post_init__(self) -> None:
        check_counts(self, "environments", "inner_steps")
        if self.drawn_steps is not None:
            check_counts(self, "drawn_steps")
        check_shares(target_decay=self.target_decay)

    def check(self, family: AbstractFamily) -> None:
        """Every family will do."""

    def in_sequence(self, torso: type[AbstractTorso]) -> bool:
        del torso
        return False  # no network has weights of its own for each task

    def policy(
        self, theta: DuelingQ, family: AbstractFamily, tasks: Task, epsilon: tuple[float, float], explorer: Explorer
    ) -> Policy:
        del family
        count = len(jax.tree.leaves(tasks)[0])
        return explorer(theta, jnp.tile(spaced(epsilon, self.environments), count))

    def replays(self, family: AbstractFamily, tasks: Task, transitions: Transition) -> Transition:
        del family, tasks
        return jax.tree.map(lambda leaf: leaf.reshape(-1, self.environments, *leaf.shape[1:]), transitions)

    def vital_signs(self, replays: Transition) -> Metrics:
        return {name: values.mean(-1) for name, values in vital_signs(replays).items()}

    def draw(self, keys: Keys, replays: Transition, target: DuelingQ) -> Trajectories:
        if self.drawn_steps is not None:
            replays = jax.vmap(pieces, in_axes=(0, 0, None))(keys, replays, self.drawn_steps)
        over_steps = lambda function: jax.vmap(jax.vmap(jax.vmap(function)))  # noqa: E731
        next_value = over_steps(target.value)(replays.next_obs)
        if self.inner_steps == 1:
            is_whole = self.inner_step_size == 1.0  # then it does not matter where the table starts
            start = next_value if is_whole else over_steps(target.q)(replays.obs, replays.action)
            return Trajectories(replays, start, next_value, None, None)
        start = over_steps(target.q)(replays.obs, replays.action)
        other = over_steps(target.best_other)(replays.obs, replays.action)
        return Trajectories(replays, start, next_value, _following(other), joined(replays))

    def adapt(self, theta: DuelingQ, samples: Trajectories) -> Steps:
        """Q_φ of every step of a task's trajectories."""
        del theta
        start = jax.lax.stop_gradient(samples.start)
        return adapt(table_td_loss, start, samples, step_size=self.inner_step_size, steps=self.inner_steps)

    def distance(self, theta: DuelingQ, phi: Steps, samples: Trajectories) -> Scalar:
        seen = samples.transitions
        q_prior = jax.vmap(jax.vmap(theta.q))(seen.obs, seen.action)
        aim = jax.lax.stop_gradient(phi)
        unit = 1.0 if theta.scaling is None else theta.scaling.return_unit
        if self.outer_loss == "squared":
            return jnp.mean(prior_learning_loss(q_prior / unit, aim / unit))
        return jnp.mean(jax.vmap(jax.vmap(lambda error: huber(error, 1.0)))((q_prior - aim) / unit))

    def moved_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        return optax.incremental_update(theta, target, 1 - self.target_decay)

    def next_target(self, theta: DuelingQ, target: DuelingQ) -> DuelingQ:
        del theta
        return target


def pieces(key: Key, transitions: Transition, steps: int) -> Transition:
    """``steps`` consecutive steps of each trajectory ``[environments, steps, ...]``, beginning anywhere.

    Trajectories of fewer steps are taken whole.
    """
    environments, length = transitions.reward.shape
    steps = min(steps, length)
    starts = jax.random.randint(key, (environments,), 0, length - steps + 1)

    def piece(start: Int[Array, ""], trajectory: Transition) -> Transition:
        return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, steps), trajectory)

    return jax.vmap(piece)(starts, transitions)


def table_td_loss(table: Steps, samples: Trajectories) -> Scalar:
    """Half the sum of Eq. 5 over all steps; targets are constants.

    A gradient step of size α moves each entry by α times its TD error. Where the next step begins with the successor,
    its value is the highest of the table's own entry and the target network's for the other actions.
    """
    seen, next_value = samples.transitions, samples.next_value
    if samples.next_other is not None and samples.joined is not None:
        along = jnp.maximum(_following(table), samples.next_other)
        next_value = jnp.where(samples.joined, along, next_value)
    losses = jax.vmap(jax.vmap(td_loss))(table, seen.reward, seen.discount, jax.lax.stop_gradient(next_value))
    return jnp.sum(losses) / 2


def _following(steps: Steps) -> Steps:
    """Each step's entry is that of the next one; the last keeps its own, which nothing uses."""
    return jnp.concatenate([steps[..., 1:], steps[..., -1:]], axis=-1)
