"""Posteriors for finite tasks: adapted to all of D_i, and compared with θ in every state at once.

One pass through the network gives Q_θ in all states of a task, so N can be large, and φ_i comes near to solving what
D_i says of its task, where one small step of the whole network hardly moves: its tangent kernel damps the directions
that tell actions apart most of all.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.equations.losses import prior_learning_loss, td_loss
from upslope.errors import UpslopeError
from upslope.learners.checks import check_counts
from upslope.learners.policies import AbstractPolicy
from upslope.meta_training.posteriors.posterior import AbstractPosterior, Explorer, repeat_tasks, spaced
from upslope.networks.dueling import DuelingQ
from upslope.tasks.family import AbstractFamily
from upslope.types import Action, Key, Keys, Metrics, Policy, Scalar, Task, Transition

QTable = Float[Array, "states actions"]


class Steps(eqx.Module):
    """What was seen of finite tasks ``[*tasks, steps]``, states by their numbers.

    Attributes:
        share: one over how often the same action was tried in the same state, so that each such pair counts once.
    """

    state: Int[Array, "*steps"]
    action: Int[Array, "*steps"]
    reward: Float[Array, "*steps"]
    discount: Float[Array, "*steps"]
    successor: Int[Array, "*steps"]
    share: Float[Array, "*steps"]


class FiniteSamples(eqx.Module):
    """What one φ_i is adapted to, and what it is compared with θ on.

    Attributes:
        observations: of every state ``[*tasks, states, *obs]``.
        steps: D_i, all of it.
        base: Q of the target network, from which a table starts ``[*tasks, states, actions]``; None if there is none.
    """

    observations: Float[Array, "..."]
    steps: Steps
    base: Float[Array, "*tasks states actions"] | None


class TablePolicy(eqx.Module):
    """ε-greedy by a table of its own for each of the ``n`` environments.

    Attributes:
        states: with ``state_number(obs)``.
        best: the best action in every state.
        explorer: explores around it.
    """

    states: Any = eqx.field(static=True)
    best: Int[Array, "n states"]
    explorer: AbstractPolicy

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Action:
        return self._act(self.explorer.noise(key, len(obs)), obs)

    def ahead(self, keys: Keys, obs: Float[Array, "n *obs"]) -> tuple[Any, Callable[..., Action]]:
        """Draws the noise of all steps now, as the policies of networks do (`AbstractPolicy.ahead`)."""
        return self.explorer.noises(keys, len(obs)), self._act

    def _act(self, noise: Any, obs: Float[Array, "n *obs"]) -> Action:
        best = self.best[jnp.arange(len(obs)), jax.vmap(self.states.state_number)(obs)]
        return self.explorer.choose(noise, best, jnp)


@dataclass(frozen=True)
class AbstractFinitePosterior(AbstractPosterior):
    """φ_i, given by Q_φ in every state of its task; D_i is used whole, each pair of state and action counting once.

    Attributes:
        environments: number of environments of each task, side by side, each with its own ε.
        inner_step_size: α, the size of an inner step.
        inner_steps: N, the number of inner steps.
        reward_weight: weight of rewarded pairs of state and action in the outer loss.
        advantage_weight: weight, in the outer loss, of the differences between the errors of a state's actions.
    """

    environments: int = 1
    inner_step_size: float = 0.01
    inner_steps: int = 1
    reward_weight: float = 1.0
    advantage_weight: float = 0.0

    def __post_init__(self) -> None:
        check_counts(self, "environments", "inner_steps")

    def check(self, family: AbstractFamily) -> None:
        """Whether the states of the tasks can be listed.

        Raises:
            UpslopeError: they can't.
        """
        if not family.lists_states:
            raise UpslopeError(
                f"The posterior {self.name!r} needs tasks whose states can be listed, and those of {family.name} "
                "can't: use NetworkPosterior()."
            )

    def policy(
        self, theta: DuelingQ, family: AbstractFamily, tasks: Task, epsilon: tuple[float, float], explorer: Explorer
    ) -> Policy:
        observations = jax.vmap(family.states.observe_all)(tasks)
        flat = observations.reshape(-1, *observations.shape[2:])
        best = jax.vmap(theta.best)(flat).reshape(observations.shape[:2])
        each = jnp.tile(spaced(epsilon, self.environments), len(observations))
        return TablePolicy(family.states, repeat_tasks(best, self.environments), explorer(theta, each))

    def replays(self, family: AbstractFamily, tasks: Task, transitions: Transition) -> FiniteSamples:
        observations = jax.vmap(family.states.observe_all)(tasks)
        number = jax.vmap(jax.vmap(family.states.state_number))
        obs, action, reward, discount, next_obs = transitions
        rows = (number(obs), action, reward, discount, number(next_obs))
        state, action, reward, discount, successor = (leaf.reshape(len(observations), -1) for leaf in rows)
        sizes = (observations.shape[1], family.actions.count)
        share = jax.vmap(lambda state, action: 1 / jnp.zeros(sizes).at[state, action].add(1.0)[state, action])
        steps = Steps(state, action, reward, discount, successor, share(state, action))
        return FiniteSamples(observations, steps, None)

    def vital_signs(self, replays: FiniteSamples) -> Metrics:
        return {"reward": jnp.mean(replays.steps.reward, axis=-1)}

    def distance(self, theta: DuelingQ, phi: QTable, samples: FiniteSamples) -> Scalar:
        q_prior, steps = jax.vmap(theta)(samples.observations), samples.steps
        return table_distance(q_prior, phi, steps, self.reward_weight, self.advantage_weight)


def q_tables(
    network: DuelingQ, observations: Float[Array, "tasks states *obs"]
) -> Float[Array, "tasks states actions"]:
    """Q in every state of every task, in one batch."""
    flat = observations.reshape(-1, *observations.shape[2:])
    return jax.vmap(network)(flat).reshape(*observations.shape[:2], -1)


def table_td_loss(table: QTable, steps: Steps) -> Scalar:
    """Half the sum of Eq. 5 over all pairs of state and action that were tried; targets are constants.

    A gradient step of size α moves Q of each pair by α times its mean TD error.
    """
    next_value = jax.lax.stop_gradient(table.max(-1))[steps.successor]
    losses = jax.vmap(td_loss)(table[steps.state, steps.action], steps.reward, steps.discount, next_value)
    return jnp.sum(steps.share * losses) / 2


def mean_td_loss(table: QTable, steps: Steps) -> Scalar:
    """The mean of Eq. 5 over the pairs that were tried."""
    return 2 * table_td_loss(table, steps) / jnp.sum(steps.share)


def table_distance(
    q_prior: QTable, q_posterior: QTable, steps: Steps, reward_weight: float, advantage_weight: float
) -> Scalar:
    """Mean of Eq. 7 over the pairs of state and action that were tried, the posterior a constant.

    Args:
        q_prior: Q_θ.
        q_posterior: Q_φ.
        steps: D_i.
        reward_weight: how often pairs count that were rewarded.
        advantage_weight: weight of the squared differences between the errors of a state's actions, on top of Eq. 7,
            in which the errors of V hide them.
    """
    aim = jax.lax.stop_gradient(q_posterior)
    errors = q_prior - aim
    tried = jnp.zeros_like(errors).at[steps.state, steps.action].max(1.0)
    rewarded = jnp.zeros_like(errors).at[steps.state, steps.action].max((steps.reward != 0).astype(errors.dtype))
    weights = tried * (1 + (reward_weight - 1) * rewarded)
    level = jnp.sum(tried * errors, axis=-1, keepdims=True) / jnp.maximum(jnp.sum(tried, axis=-1, keepdims=True), 1)
    losses = prior_learning_loss(q_prior, aim) + advantage_weight * (errors - level) ** 2
    return jnp.sum(weights * losses) / jnp.sum(weights)
