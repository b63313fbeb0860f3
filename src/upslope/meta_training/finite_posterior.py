"""Algorithm 1's task-posterior for finite tasks, adapted to all of D_i: a table, the two heads, or all weights of θ.

One pass through the network gives Q_θ in all states of a task at once, and adapting a table of it costs next to
nothing. So N can be large, and φ_i comes near to solving what D_i tells of its task, where one small step of the
whole network hardly moves: its kernel damps the directions that tell actions apart most of all.

With N = 1 and α = 1 the table is one Bellman backup, and Eq. 7 is the loss of multi-task DQN.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from upslope.equations.losses import dueling_q, td_loss
from upslope.equations.maml import adapt
from upslope.learners.policies import EpsilonGreedy
from upslope.meta_training.recipes import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ
from upslope.tasks.jax_tasks import JaxTasks
from upslope.types import Key, Scalar, Task

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
    """What one φ_i and its outer loss are computed from.

    Attributes:
        observations: of every state ``[*tasks, states, *obs]``.
        steps: D_i, all of it.
        base: Q of the averaged network, from which φ_i starts ``[*tasks, states, actions]``; Q_θ if None.
    """

    observations: Float[Array, "..."]
    steps: Steps
    base: Float[Array, "*tasks states actions"] | None


class TablePolicy(eqx.Module):
    """ε-greedy by a table of its own for each of the ``n`` environments."""

    env: Any = eqx.field(static=True)
    q: Float[Array, "n states actions"]
    epsilon: Float[Array, "n"]

    def __call__(self, key: Key, obs: Float[Array, "n *obs"]) -> Int[Array, "n"]:
        scores = self.q[jnp.arange(obs.shape[0]), jax.vmap(self.env.state_number)(obs)]
        return EpsilonGreedy(lambda row: row, self.epsilon)(key, scores)


def collect_steps(
    key: Key, family: JaxTasks, tasks: Task, theta: DuelingQ, epsilon: Float[Array, "environments"], steps: int
) -> FiniteSamples:
    """Fresh D_i ``[tasks, environments · steps]``: several environments of each task, each with its own ε."""
    observations = jax.vmap(family.env.observe_all)(tasks)
    copies, count = len(epsilon), observations.shape[0]

    def repeat(leaf: Array) -> Array:
        return jnp.repeat(leaf, copies, axis=0)

    reset_key, act_key = jax.random.split(key)
    policy = TablePolicy(family.env, repeat(q_tables(theta, observations)), jnp.tile(epsilon, count))
    many = jax.tree.map(repeat, tasks)
    _, seen = family.collect(act_key, many, family.reset(reset_key, many), policy, steps)
    number = jax.vmap(jax.vmap(family.env.state_number))
    found = (number(seen.obs), seen.action, seen.reward, seen.discount, number(seen.next_obs))
    state, action, reward, discount, successor = (leaf.reshape(count, copies * steps) for leaf in found)
    sizes = (observations.shape[1], family.actions.count)
    share = jax.vmap(lambda state, action: 1 / jnp.zeros(sizes).at[state, action].add(1.0)[state, action])(
        state, action
    )
    return FiniteSamples(observations, Steps(state, action, reward, discount, successor, share), None)


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
    next_q = jax.lax.stop_gradient(table[steps.successor])
    losses = jax.vmap(td_loss)(table[steps.state], steps.action, steps.reward, steps.discount, next_q)
    return jnp.sum(steps.share * losses) / 2


def mean_td_loss(table: QTable, steps: Steps) -> Scalar:
    """The mean of Eq. 5 over the pairs that were tried."""
    return 2 * table_td_loss(table, steps) / jnp.sum(steps.share)


def posterior_table(base: QTable, steps: Steps, *, step_size: float, inner_steps: int) -> QTable:
    """Q_φ of a task: Eq. 2, N times, from a network's Q; nothing changes where nothing was tried."""
    return adapt(table_td_loss, base, steps, step_size=step_size, steps=inner_steps)


def posterior_heads(
    theta: DuelingQ, observations: Float[Array, "states *obs"], experience: Steps, **inner: Any
) -> QTable:
    """Q_φ of a task, φ being θ with heads of its own, adapted by Eq. 2 to the mean of Eq. 5 over the pairs.

    Args:
        theta: θ.
        observations: of every state.
        experience: D_i.
        inner: how it is adapted: see `upslope.equations.maml.adapt`.
    """
    features = jax.vmap(theta.torso)(observations)

    def q(heads: tuple[eqx.nn.Linear, eqx.nn.Linear]) -> QTable:
        value, advantage = (jax.vmap(head)(features) for head in heads)
        return jax.vmap(dueling_q)(value[:, 0], advantage)

    heads = theta.value_head, theta.advantage_head
    return q(adapt(lambda heads, experience: mean_td_loss(q(heads), experience), heads, experience, **inner))


def posterior_weights(
    theta: DuelingQ, observations: Float[Array, "states *obs"], experience: Steps, **inner: Any
) -> QTable:
    """The same, all weights of θ being adapted."""

    def q(network: DuelingQ) -> QTable:
        return jax.vmap(network)(observations)

    return q(adapt(lambda network, experience: mean_td_loss(q(network), experience), theta, experience, **inner))


def outer_loss_in_all_states(theta: DuelingQ, samples: FiniteSamples, config: MetaTrainingConfig) -> Scalar:
    """Eq. 7 for one finite task, φ_i adapted from θ to all of D_i as ``config.posterior`` says."""
    steps, q_prior = samples.steps, jax.vmap(theta)(samples.observations)
    if config.posterior == "table":
        base = jax.lax.stop_gradient(q_prior) if samples.base is None else samples.base
        q = posterior_table(base, steps, step_size=config.inner_step_size, inner_steps=config.inner_steps)
    else:
        adapted = posterior_heads if config.posterior == "heads" else posterior_weights
        q = adapted(jax.lax.stop_gradient(theta), samples.observations, steps, **config.inner)
    weights = {"reward_weight": config.reward_weight, "advantage_weight": config.advantage_weight}
    return table_distance(q_prior, q, steps, **weights)


def table_distance(
    q_prior: QTable, q_posterior: QTable, steps: Steps, *, reward_weight: float, advantage_weight: float
) -> Scalar:
    """Mean of Eq. 7 over the pairs of state and action that were tried, the posterior a constant.

    Args:
        q_prior: Q_θ.
        q_posterior: Q_φ.
        steps: D_i.
        reward_weight: how often pairs count that were rewarded.
        advantage_weight: what the errors are punished with, squared, as far as they differ between the actions of a
            state: on top of Eq. 7, which hardly notices them beside the errors of V.
    """
    errors = q_prior - jax.lax.stop_gradient(q_posterior)
    tried = jnp.zeros_like(errors).at[steps.state, steps.action].max(1.0)
    rewarded = jnp.zeros_like(errors).at[steps.state, steps.action].max((steps.reward != 0).astype(errors.dtype))
    weights = tried * (1 + (reward_weight - 1) * rewarded)
    level = jnp.sum(tried * errors, axis=-1, keepdims=True) / jnp.maximum(jnp.sum(tried, axis=-1, keepdims=True), 1)
    punished = errors**2 + advantage_weight * (errors - level) ** 2
    return jnp.sum(weights * punished) / jnp.sum(weights)
