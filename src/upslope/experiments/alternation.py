"""Thm. 3.2 on maps: Eqs. 8 and 9 in turn, on tables and with Algorithm 2's own step on a network."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.agents.adaptation import AdvantageHead
from upslope.experiments.theorem_maps import Maps, for_each, known
from upslope.losses import advantage_loss, value_loss
from upslope.maml import descend
from upslope.measures import Truth
from upslope.measures import truth as truth_of
from upslope.networks import DuelingQ
from upslope.planning import TabularMDP, best_actions, shape_mdp
from upslope.types import Key, Transition

#: α of the tables: a step of Eq. 8 or 9 then goes half of the way to its target.
TABLE_STEP = 0.25

#: Widths of the network on one map.
HIDDEN = (64, 64)


class Tables(NamedTuple):
    """A(s, a) and V(s) as tables."""

    advantage: Float[Array, "states actions"]
    value: Float[Array, "states"]


def alternate(mdp: TabularMDP, tables: Tables, *, move_value: bool = True) -> Tables:
    """One step of Eq. 8 in expectation over the outcomes, with Φ = V, then one of Eq. 9."""
    states = mdp.acting
    shaped = shape_mdp(mdp, tables.value)
    following = jax.lax.stop_gradient(tables.advantage)[mdp.successors]

    def advantage_objective(advantage: Float[Array, "states actions"]) -> Array:
        def one(scores: Array, action: Array, reward: Array, discount: Array, following: Array, chance: Array) -> Array:
            losses = jax.vmap(advantage_loss, (None, None, 0, 0, 0))(scores, action, reward, discount, following)
            return jnp.sum(chance * losses)

        actions = jnp.arange(advantage.shape[-1])
        over_actions = jax.vmap(one, (None, 0, 0, 0, 0, 0))
        over_states = jax.vmap(over_actions, (0, None, 0, 0, 0, 0))
        losses = over_states(advantage, actions, shaped.rewards, mdp.discounts, following, mdp.probabilities)
        return jnp.sum(losses, where=states[:, None])

    advantage = descend(tables.advantage, jax.grad(advantage_objective)(tables.advantage), TABLE_STEP)
    if not move_value:
        return Tables(advantage, tables.value)

    def value_objective(value: Float[Array, "states"]) -> Array:
        return jnp.sum(jax.vmap(value_loss)(value, advantage), where=states)

    return Tables(advantage, descend(tables.value, jax.grad(value_objective)(tables.value), TABLE_STEP))


def tabular(maps: Maps, seed: int, *, pairs: int, every: int) -> dict[str, Any]:
    """From random tables: the distance to V* and to Q* − V* over pairs of steps, the worst state of the worst map.

    Returns:
        ``pairs``; ``value`` and ``advantage``, distances at each of them; ``fixed``, the distance of A to Q* − Φ where
        V stays what it was (Eq. 8 alone); ``median_value``, that of the median map.
    """
    keys = jax.random.split(jax.random.key(seed), len(maps.params.start))

    def one_map(params: Any, key: Key) -> tuple[Array, Array, Array]:
        truth = known(maps, params)
        advantage_key, value_key = jax.random.split(key)
        cells = maps.env.cells
        start = Tables(jax.random.normal(advantage_key, (cells, 4)), jax.random.normal(value_key, (cells,)))

        def some_pairs(tables: Tables, _: None) -> tuple[Tables, tuple[Array, Array]]:
            tables = jax.lax.fori_loop(0, every, lambda _, tables: alternate(truth.mdp, tables), tables)
            return tables, distances(truth, tables, tables.value)

        def alone(_: Array, tables: Tables) -> Tables:
            return alternate(truth.mdp, tables, move_value=False)

        _, (value, advantage) = jax.lax.scan(some_pairs, start, length=pairs // every)
        fixed = distances(truth, jax.lax.fori_loop(0, pairs, alone, start), start.value)[1]
        before = distances(truth, start, start.value)
        return jnp.append(before[0], value), jnp.append(before[1], advantage), fixed

    value, advantage, fixed = for_each(one_map, maps.params, keys)
    return {
        "maps": len(maps.params.start),
        "pairs": list(range(0, pairs + 1, every)),
        "value": value.max(axis=0).tolist(),
        "median_value": np.median(value, axis=0).tolist(),
        "advantage": advantage.max(axis=0).tolist(),
        "fixed": float(fixed.max()),
    }


def distances(truth: Truth, tables: Tables, potential: Float[Array, "states"]) -> tuple[Array, Array]:
    """Largest |V − V*|, and largest |A − (Q* − Φ)|, over the states that count."""
    value = jnp.max(jnp.abs(tables.value - truth.solution.value), where=truth.states, initial=0.0)
    gap = tables.advantage - (truth.solution.action_value - potential[:, None])
    return value, jnp.max(jnp.abs(gap), where=truth.states[:, None], initial=0.0)


def on_a_network(family: Any, task: Any, *, seed: int, seeds: int, updates: int, every: int, step_size: float) -> Any:
    """Algorithm 2's step on a dueling network, from random weights, over every transition of one small map.

    Args:
        family: with flat observations and without slipping.
        task: one map.
        seed: the first of the seeds.
        seeds: networks.
        updates: pairs of Eqs. 8 and 9.
        every: updates between looks.
        step_size: α of plain gradient descent.

    Returns:
        ``updates``; ``value`` and ``policy`` ``[seeds][looks]``: the largest |V − V*| over the states that count, and
        the share of them in which the greedy action is optimal.
    """
    truth = truth_of(family.env, task, family.gamma)
    states = np.flatnonzero(truth.states)
    batch = every_transition(family, task, truth, states)
    rule = AdvantageHead(centred=False)
    observations = family.env.observe_all(task)[states]

    def look(network: DuelingQ) -> tuple[Array, Array]:
        value, advantage = jax.vmap(network.heads)(observations)
        optimal = best_actions(truth.solution.action_value)[states]
        chosen = jnp.argmax(advantage, axis=-1)
        right = jnp.take_along_axis(optimal, chosen[:, None], axis=-1)
        return jnp.max(jnp.abs(value - truth.solution.value[states])), jnp.mean(right)

    def one_seed(key: Key) -> tuple[Array, Array]:
        start = DuelingQ(key, family.observation_shape[0], family.actions, HIDDEN, activation="tanh")

        def some_updates(network: DuelingQ, _: None) -> tuple[DuelingQ, tuple[Array, Array]]:
            step = jnp.asarray(step_size)
            following = jax.lax.fori_loop(0, every, lambda _, phi: rule.update(phi, start, batch, step), network)
            return following, look(following)

        _, looks = jax.lax.scan(some_updates, start, length=updates // every)
        return jax.tree.map(lambda first, rest: jnp.append(first, rest), look(start), looks)

    value, policy = jax.jit(jax.vmap(one_seed))(jnp.stack([jax.random.key(seed + n) for n in range(seeds)]))
    return {
        "updates": list(range(0, updates + 1, every)),
        "value": np.asarray(value).tolist(),
        "policy": np.asarray(policy).tolist(),
    }


def every_transition(family: Any, task: Any, truth: Truth, states: np.ndarray) -> Transition:
    """Each action once in each of the states, without slipping, as one batch."""
    observations = family.env.observe_all(task)
    actions = jnp.tile(jnp.arange(family.actions), len(states))
    here = jnp.repeat(jnp.asarray(states), family.actions)
    mdp = truth.mdp
    return Transition(
        observations[here],
        actions,
        mdp.rewards[here, actions, 0],
        mdp.discounts[here, actions, 0],
        observations[mdp.successors[here, actions, 0]],
    )
