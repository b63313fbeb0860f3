"""Posteriors that adapt weights to all experience from a finite task: the two heads, or the whole network."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_close, largest
from support.finite import steps_of
from support.meta import outer_gradient
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.posteriors import HeadsPosterior, WeightsPosterior
from upslope.meta_training.posteriors.finite import FiniteSamples, table_distance
from upslope.meta_training.recipes import for_grid_games

MAPS = 2
STEPS = steps_of((0, 0, 0.5, 0.9, 1, 1.0), (5, 2, 1.0, 0.0, 0, 0.5), (5, 2, 0.0, 0.9, 3, 0.5))


@pytest.mark.parametrize("kind", [HeadsPosterior, WeightsPosterior])
def test_a_step_descends_the_mean_of_equation_5(theta, observations, kind):
    def loss(network):
        q = jax.vmap(network)(observations)
        targets = jax.lax.stop_gradient([0.5 + 0.9 * q[1].max(), 1.0, 0.9 * q[3].max()])
        first, *second = ((target - value) ** 2 for target, value in zip(targets, q[(0, 5, 5), (0, 2, 2)], strict=True))
        return (first + sum(second) / 2) / 2  # two pairs, the second one twice

    slope = jax.jit(jax.grad(loss))(theta)
    if kind is HeadsPosterior:
        slope = eqx.tree_at(lambda net: net.torso, slope, jax.tree.map(jnp.zeros_like, slope.torso))
    expected = jax.vmap(jax.tree.map(lambda p, g: p - 0.1 * g, theta, slope))(observations)
    posterior = kind(inner_step_size=0.1, inner_steps=1)
    result = jax.jit(lambda: posterior.adapt(theta, FiniteSamples(observations, STEPS, None)))()
    np.testing.assert_allclose(result, expected, rtol=1e-4, atol=1e-5)
    assert largest(result - jax.vmap(theta)(observations)) > 1e-3


def test_a_normalised_step_removes_its_share_of_one_error(theta, observations):
    """Heads are linear, so a full step removes a single pair's TD error completely (V alone can do so)."""
    best = int(jax.vmap(theta)(observations)[2].argmax())
    one = FiniteSamples(observations, steps_of((2, best, 1.0, 0.0, 0, 1.0)), None)
    before = float(jax.vmap(theta)(observations)[2, best])
    for share in (1.0, 0.4):
        result = HeadsPosterior(inner_step_size=share, normalised_steps=True).adapt(theta, one)
        assert float(result[2, best]) == pytest.approx(before + share * (1 - before), abs=2e-4)


@pytest.mark.parametrize("kind", [HeadsPosterior, pytest.param(WeightsPosterior, marks=pytest.mark.slow)])
def test_algorithm_1_moves_towards_them(maps, theta, samples, kind):
    posterior = kind(
        inner_step_size=0.3, inner_steps=2, normalised_steps=True, reward_weight=5.0, advantage_weight=30.0
    )
    meta = MetaTraining(maps, dataclasses.replace(for_grid_games(4), hidden=(8, 8), posterior=posterior))
    aims = [posterior.adapt(theta, jax.tree.map(lambda leaf, i=task: leaf[i], samples)) for task in range(MAPS)]

    def distance(network):
        def of_task(task):
            seen, steps = jax.tree.map(lambda leaf: leaf[task], (samples.observations, samples.steps))
            q = jax.vmap(network)(seen)
            return table_distance(q, aims[task], steps, reward_weight=5.0, advantage_weight=30.0)

        return sum(of_task(task) for task in range(MAPS)) / MAPS

    expected, slope = jax.jit(jax.value_and_grad(distance))(theta)
    loss, gradient = jax.jit(lambda network: outer_gradient(meta, network, samples))(theta)
    assert float(loss) == pytest.approx(float(expected), rel=1e-3)
    assert largest(slope) > 1e-3
    assert_trees_close(gradient, slope, rtol=5e-3, atol=1e-4)
