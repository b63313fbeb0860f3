"""Thm. 3.2 on maps: Eqs. 8 and 9 alternate, on tables and with Algorithm 2's step on a network."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from upslope.adaptation.algorithm2 import advantage_step_loss, value_step_loss
from upslope.equations.losses import advantage_loss, value_loss
from upslope.equations.maml import descend
from upslope.experiments.theorems.maps import Maps, exact_truth, for_each
from upslope.networks.dueling import DuelingQ
from upslope.planning.exact import TabularMDP, shape_mdp
from upslope.planning.measures import Truth, action_optimality
from upslope.planning.measures import truth as truth_of
from upslope.types import Key, Observation, Transition

#: α for tables: a step of Eq. 8 or 9 goes half of the way to its target.
TABLE_STEP = 0.25

#: Ratios of Eq. 9's step to Eq. 8's. Algorithm 2 has 1.
RATIOS = (1.0, 0.1)

#: The scale of the tables' initial values, which are N(0, scale²), and a ratio.
STARTS: dict[str, tuple[float, float]] = {
    "random, ratio 1": (1.0, 1.0),
    "zero, ratio 1": (0.0, 1.0),
    "random, ratio 0.1": (1.0, 0.1),
}

#: Distances below this count as converged.
CONVERGED = 1e-3

#: Widths of the network's layers.
HIDDEN = (64, 64)


class Tables(NamedTuple):
    """A(s, a) and V(s) as tables."""

    advantage: Float[Array, "states actions"]
    value: Float[Array, "states"]


def alternate(mdp: TabularMDP, tables: Tables, ratio: float | Array) -> Tables:
    """One step of Eq. 8 in expectation over the outcomes, with Φ = V, and one of Eq. 9, ``ratio`` times as long."""
    states = mdp.acting
    shaped = shape_mdp(mdp, tables.value)
    highest_next_advantage = jax.lax.stop_gradient(tables.advantage.max(-1))[mdp.successors]

    def advantage_objective(advantage: Float[Array, "states actions"]) -> Array:
        # The outcomes of a state and action are the last axis.
        of_outcomes = jnp.vectorize(advantage_loss)(
            advantage[..., None], shaped.rewards, mdp.discounts, highest_next_advantage
        )
        losses = jnp.sum(mdp.probabilities * of_outcomes, axis=-1)
        return jnp.sum(losses, where=states[:, None])

    advantage = descend(tables.advantage, jax.grad(advantage_objective)(tables.advantage), TABLE_STEP)

    def value_objective(value: Float[Array, "states"]) -> Array:
        return jnp.sum(jax.vmap(value_loss)(value, advantage.max(-1)), where=states)

    return Tables(advantage, descend(tables.value, jax.grad(value_objective)(tables.value), ratio * TABLE_STEP))


def tabular(maps: Maps, seed: int, *, pairs: int, every: int) -> dict[str, Any]:
    """The largest distances to V* and to Q* − V* on every map, over pairs of steps.

    Returns:
        ``pairs``, the numbers of pairs; for each of `STARTS` the distance of V on the ``median`` and the ``worst`` map
        after each number of pairs, the share of maps that ``converged`` (V and A within 0.001 at the end), and the
        worst distance of A, ``advantage``, at the end; ``fixed``, the distance of A to Q* − Φ with V frozen (Eq. 8
        alone).
    """
    keys = jax.random.split(jax.random.key(seed), len(maps.params.start))

    def one_map(params: Any, key: Key) -> tuple[Array, Array, Array]:
        truth = exact_truth(maps, params)
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

        frozen_value = jax.lax.fori_loop(0, pairs, lambda _, tables: alternate(truth.mdp, tables, 0.0), random)
        scales, ratios = jnp.asarray(list(STARTS.values())).T
        return *jax.vmap(from_start)(scales, ratios), distances(truth, frozen_value)[1]

    value, advantage, fixed = for_each(one_map, maps.params, keys)
    starts = {}
    for index, start in enumerate(STARTS):
        has_converged = (value[:, index, -1] < CONVERGED) & (advantage[:, index, -1] < CONVERGED)
        starts[start] = {
            "median": np.median(value[:, index], axis=0).tolist(),
            "worst": value[:, index].max(axis=0).tolist(),
            "advantage": float(advantage[:, index, -1].max()),
            "converged": float(has_converged.mean()),
        }
    return {
        "maps": len(maps.params.start),
        "pairs": list(range(0, pairs + 1, every)),
        "starts": starts,
        "fixed": float(fixed.max()),
    }


def stable_ratio(gamma: float) -> float:
    """The largest ratio below which small errors shrink for every greedy policy; above it, some policies amplify them.

    With a fixed greedy policy, the errors e of A and V follow e_A' = −M(e_A + e_V) and e_V' = ratio·e_A in the limit of
    small steps, where M = I − γP. Along an eigenvector of M with eigenvalue μ the solutions grow as exp(λt) with
    λ² + μλ + ratio·μ = 0, so both shrink if and only if ratio < Re μ·|μ|²/(Im μ)². The eigenvalues of γP lie in the
    disc of radius γ, and for cycles on its boundary. The result is the minimum of the bound over the boundary.
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
        family: a family with flat observations and without slipping.
        task: one map.
        seed: the first seed.
        seeds: the number of networks.
        updates: the number of pairs of Eqs. 8 and 9.
        every: updates between evaluations.
        step_size: α of plain gradient descent on Eq. 8; for Eq. 9 it is multiplied by each of `RATIOS`.

    Returns:
        ``updates``; for each of `RATIOS`, ``[seeds][evaluations]``, the largest distance of ``value`` to V* and of
        ``advantage`` to Q* − V*, and the share of states with an optimal greedy action, ``policy``.
    """
    truth = truth_of(family.env, task, family.gamma)
    states = np.flatnonzero(truth.states)
    batch = every_transition(family, task, truth, states)

    def level(_: Observation) -> Array:
        return jnp.zeros(())  # A is raw, because there is no prior to centre it by

    observations = family.env.observe_all(task)

    def pair(phi: DuelingQ, ratio: Array) -> DuelingQ:
        phi = descend(phi, jax.grad(advantage_step_loss)(phi, phi, batch, level), step_size)
        return descend(phi, jax.grad(value_step_loss)(phi, batch, level), ratio * step_size)

    def evaluate(network: DuelingQ) -> tuple[Array, Array, Array]:
        value, advantage = jax.vmap(network.heads)(observations)
        optimality = action_optimality(advantage, truth.solution.action_value, truth.states)
        return *distances(truth, Tables(advantage, value)), optimality

    def one_run(key: Key, ratio: Array) -> tuple[Array, Array, Array]:
        start = DuelingQ(key, family.observation_shape[0], family.actions.count, HIDDEN)

        def some_updates(network: DuelingQ, _: None) -> tuple[DuelingQ, tuple[Array, Array, Array]]:
            trained = jax.lax.fori_loop(0, every, lambda _, phi: pair(phi, ratio), network)
            return trained, evaluate(trained)

        _, evaluations = jax.lax.scan(some_updates, start, length=updates // every)
        return jax.tree.map(jnp.append, evaluate(start), evaluations)

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
