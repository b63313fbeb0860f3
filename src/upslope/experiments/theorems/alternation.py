"""Thm. 3.2 on maps: Eqs. 8 and 9 in turn, on tables and with Algorithm 2's own step on a network."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.adaptation.algorithm2 import advantage_step_loss, value_step_loss
from upslope.equations.losses import advantage_loss, value_loss
from upslope.equations.maml import descend
from upslope.experiments.theorems.maps import Maps, for_each, known
from upslope.networks.dueling import DuelingQ
from upslope.planning.exact import TabularMDP, shape_mdp
from upslope.planning.measures import Truth, action_optimality
from upslope.planning.measures import truth as truth_of
from upslope.types import Key, Observation, Transition

#: α of the tables: a step of Eq. 8 or 9 then goes half of the way to its target.
TABLE_STEP = 0.25

#: How long the step of Eq. 9 is, in steps of Eq. 8. Algorithm 2 takes 1.
RATIOS = (1.0, 0.1)

#: Tables start as N(0, scale²), with a ratio.
STARTS: dict[str, tuple[float, float]] = {
    "random, ratio 1": (1.0, 1.0),
    "zero, ratio 1": (0.0, 1.0),
    "random, ratio 0.1": (1.0, 0.1),
}

#: Where a distance counts as none.
CONVERGED = 1e-3

#: Widths of the network on one map.
HIDDEN = (64, 64)


class Tables(NamedTuple):
    """A(s, a) and V(s) as tables."""

    advantage: Float[Array, "states actions"]
    value: Float[Array, "states"]


def alternate(mdp: TabularMDP, tables: Tables, ratio: float | Array) -> Tables:
    """One step of Eq. 8 in expectation over the outcomes, with Φ = V, then one of Eq. 9, ``ratio`` times as long."""
    states = mdp.acting
    shaped = shape_mdp(mdp, tables.value)
    following = jax.lax.stop_gradient(tables.advantage.max(-1))[mdp.successors]

    def advantage_objective(advantage: Float[Array, "states actions"]) -> Array:
        # The outcomes of a state and action have the last axis.
        of_outcomes = advantage_loss(advantage[..., None], shaped.rewards, mdp.discounts, following)
        losses = jnp.sum(mdp.probabilities * of_outcomes, axis=-1)
        return jnp.sum(losses, where=states[:, None])

    advantage = descend(tables.advantage, jax.grad(advantage_objective)(tables.advantage), TABLE_STEP)

    def value_objective(value: Float[Array, "states"]) -> Array:
        return jnp.sum(value_loss(value, advantage.max(-1)), where=states)

    return Tables(advantage, descend(tables.value, jax.grad(value_objective)(tables.value), ratio * TABLE_STEP))


def tabular(maps: Maps, seed: int, *, pairs: int, every: int) -> dict[str, Any]:
    """The largest distance to V* and to Q* − V* on every map, over pairs of steps.

    Returns:
        ``pairs``; for each of `STARTS` the ``median`` map's and the ``worst`` map's distance of V at each of them, the
        share of maps that ``converged`` (V and A within 0.001 at the end), and the worst ``advantage`` at the end;
        ``fixed``, the distance of A to Q* − Φ where V stays what it was (Eq. 8 alone).
    """
    keys = jax.random.split(jax.random.key(seed), len(maps.params.start))

    def one_map(params: Any, key: Key) -> tuple[Array, Array, Array]:
        truth = known(maps, params)
        advantage_key, value_key = jax.random.split(key)
        cells = maps.env.cells
        random = Tables(jax.random.normal(advantage_key, (cells, 4)), jax.random.normal(value_key, (cells,)))

        def from_start(scale: Array, ratio: Array) -> tuple[Array, Array]:
            start = Tables(scale * random.advantage, scale * random.value)

            def some_pairs(tables: Tables, _: None) -> tuple[Tables, tuple[Array, Array]]:
                tables = jax.lax.fori_loop(0, every, lambda _, tables: alternate(truth.mdp, tables, ratio), tables)
                return tables, distances(truth, tables)

            _, (value, advantage) = jax.lax.scan(some_pairs, start, length=pairs // every)
            before = distances(truth, start)
            return jnp.append(before[0], value), jnp.append(before[1], advantage)

        alone = jax.lax.fori_loop(0, pairs, lambda _, tables: alternate(truth.mdp, tables, 0.0), random)
        scales, ratios = jnp.asarray(list(STARTS.values())).T
        return *jax.vmap(from_start)(scales, ratios), distances(truth, alone)[1]

    value, advantage, fixed = for_each(one_map, maps.params, keys)
    starts = {}
    for index, start in enumerate(STARTS):
        near = (value[:, index, -1] < CONVERGED) & (advantage[:, index, -1] < CONVERGED)
        starts[start] = {
            "median": np.median(value[:, index], axis=0).tolist(),
            "worst": value[:, index].max(axis=0).tolist(),
            "advantage": float(advantage[:, index, -1].max()),
            "converged": float(near.mean()),
        }
    return {
        "maps": len(maps.params.start),
        "pairs": list(range(0, pairs + 1, every)),
        "starts": starts,
        "fixed": float(fixed.max()),
    }


def stable_ratio(gamma: float) -> float:
    """Below this ratio small errors die out whatever the greedy policy is; above it, some policies amplify them.

    With a fixed greedy policy the errors e of A and V follow e_A' = −M(e_A + e_V) and e_V' = ratio·e_A in the limit of
    small steps, M = I − γP. Along an eigenvector of M with eigenvalue μ the solutions grow as exp(λt) with
    λ² + μλ + ratio·μ = 0, so both shrink if and only if ratio < Re μ·|μ|²/(Im μ)². The eigenvalues of γP lie in the
    disc of radius γ, and on its rim for cycles: the least of the bound over the rim is returned.
    """
    angle = np.linspace(1e-4, np.pi - 1e-4, 100_000)
    mu = 1 - gamma * np.exp(1j * angle)
    return float(np.min(mu.real * np.abs(mu) ** 2 / mu.imag**2))


def distances(truth: Truth, tables: Tables) -> tuple[Array, Array]:
    """Largest |V − V*|, and largest |A − (Q* − Φ)| with Φ = V, over the states that count."""
    value = jnp.max(jnp.abs(tables.value - truth.solution.value), where=truth.states, initial=0.0)
    gap = tables.advantage - (truth.solution.action_value - tables.value[:, None])
    return value, jnp.max(jnp.abs(gap), where=truth.states[:, None], initial=0.0)


def on_a_network(
    family: Any, task: Any, *, seed: int, seeds: int, updates: int, every: int, step_size: float
) -> dict[str, Any]:
    """Eqs. 8 and 9 on a dueling network from random weights, over every transition of one small map.

    Args:
        family: with flat observations and without slipping.
        task: one map.
        seed: the first of the seeds.
        seeds: networks.
        updates: pairs of Eqs. 8 and 9.
        every: updates between looks.
        step_size: α of plain gradient descent on Eq. 8; Eq. 9 takes that times each of `RATIOS`.

    Returns:
        ``updates``; for each of `RATIOS`, ``[seeds][looks]``, the largest distance of ``value`` to V* and of
        ``advantage`` to Q* − V*, and the share of states with an optimal greedy action, ``policy``.
    """
    truth = truth_of(family.env, task, family.gamma)
    states = np.flatnonzero(truth.states)
    batch = every_transition(family, task, truth, states)

    def level(_: Observation) -> Array:
        return jnp.zeros(())  # A is raw: there is no prior to centre it by

    observations = family.env.observe_all(task)

    def pair(phi: DuelingQ, ratio: Array) -> DuelingQ:
        phi = descend(phi, jax.grad(advantage_step_loss)(phi, phi, batch, level), step_size)
        return descend(phi, jax.grad(value_step_loss)(phi, batch, level), ratio * step_size)

    def look(network: DuelingQ) -> tuple[Array, Array, Array]:
        value, advantage = jax.vmap(network.heads)(observations)
        right = action_optimality(advantage, truth.solution.action_value, truth.states)
        return *distances(truth, Tables(advantage, value)), right

    def one_run(key: Key, ratio: Array) -> tuple[Array, Array, Array]:
        start = DuelingQ(key, family.observation_shape[0], family.actions.count, HIDDEN)

        def some_updates(network: DuelingQ, _: None) -> tuple[DuelingQ, tuple[Array, Array, Array]]:
            following = jax.lax.fori_loop(0, every, lambda _, phi: pair(phi, ratio), network)
            return following, look(following)

        _, looks = jax.lax.scan(some_updates, start, length=updates // every)
        return jax.tree.map(jnp.append, look(start), looks)

    keys = jnp.stack([jax.random.key(seed + number) for number in range(seeds)])
    over_ratios = jax.vmap(jax.vmap(one_run, (0, None)), (None, 0))
    value, advantage, policy = jax.device_get(jax.jit(over_ratios)(keys, jnp.asarray(RATIOS)))
    return {
        "updates": list(range(0, updates + 1, every)),
        "ratios": {
            str(ratio): {"value": value[n].tolist(), "advantage": advantage[n].tolist(), "policy": policy[n].tolist()}
            for n, ratio in enumerate(RATIOS)
        },
    }


def every_transition(family: Any, task: Any, truth: Truth, states: np.ndarray) -> Transition:
    """Each action once in each of the states, without slipping, as one batch."""
    observations = family.env.observe_all(task)
    actions = jnp.tile(jnp.arange(family.actions.count), len(states))
    here = jnp.repeat(jnp.asarray(states), family.actions.count)
    mdp = truth.mdp
    return Transition(
        observations[here],
        actions,
        mdp.rewards[here, actions, 0],
        mdp.discounts[here, actions, 0],
        observations[mdp.successors[here, actions, 0]],
    )
