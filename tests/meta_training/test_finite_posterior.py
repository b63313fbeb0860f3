"""Common parts of the posteriors of finite tasks: experience by state index, and the weights of Eq. 7."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import largest
from support.finite import steps_of
from support.meta import outer_gradient, outer_loss
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.posteriors.finite import mean_td_loss, q_tables, table_distance, table_td_loss
from upslope.meta_training.recipes import for_grid_games
from upslope.planning.exact import tabulate

MAPS, CELLS, ACTIONS = 2, 12, 4


class TestCollecting:
    def test_steps_match_the_map(self, maps, tasks, samples):
        for index in range(MAPS):
            task = jax.tree.map(lambda leaf, i=index: leaf[i], tasks)
            steps = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), samples.steps)
            mdp = tabulate(maps.env, task, maps.gamma)
            at = (steps.state, steps.action, 0)
            np.testing.assert_array_equal(steps.successor, mdp.successors[at])
            np.testing.assert_array_equal(steps.reward, mdp.rewards[at])
            np.testing.assert_allclose(steps.discount, mdp.discounts[at])
            assert steps.state[0] == task.start
            assert len(np.unique(steps.state)) > 2

    def test_shares_of_a_pair_add_up_to_one(self, samples):
        for index in range(MAPS):
            steps = jax.tree.map(lambda leaf, i=index: np.asarray(leaf[i]), samples.steps)
            totals = np.zeros((CELLS, ACTIONS))
            np.add.at(totals, (steps.state, steps.action), steps.share)
            np.testing.assert_allclose(totals[totals > 0], 1.0, rtol=1e-5)

    def test_environments_of_a_map_have_their_own_epsilon(self, maps, state, tasks):
        config = dataclasses.replace(for_grid_games(4), hidden=(8, 8), steps_per_task=200, epsilon=(0.0, 1.0))
        meta = MetaTraining(maps, config.with_posterior(environments=2))
        collect = jax.jit(lambda tasks: meta.collect(jax.random.key(1), tasks, state.theta, state.iteration)())
        collected = collect(tasks)
        greedy = np.asarray(jnp.argmax(q_tables(state.theta, collected.observations), axis=-1))
        for index in range(MAPS):
            explored = (
                np.asarray(collected.steps.action[index]) != greedy[index][np.asarray(collected.steps.state[index])]
            )
            assert explored[:200].mean() == 0
            assert explored[200:].mean() == pytest.approx(0.75, abs=0.12)

    @pytest.mark.slow
    @pytest.mark.parametrize(("longest", "changes"), [(1, 0.75), (50, 0.137)])
    def test_random_actions_are_held_here_too(self, maps, state, tasks, longest, changes):
        config = dataclasses.replace(for_grid_games(4), hidden=(8, 8), epsilon=(1.0, 1.0), longest_hold=longest)
        meta = MetaTraining(maps, config.with_posterior(environments=16))
        collect = jax.jit(lambda tasks: meta.collect(jax.random.key(1), tasks, state.theta, state.iteration)())
        action = np.asarray(collect(tasks).steps.action).reshape(MAPS, 16, -1)
        assert (np.diff(action, axis=2) != 0).mean() == pytest.approx(changes, abs=0.03)


class TestOuterLoss:
    PRIOR = jnp.array([[1.0, 0.0, 7.0], [2.0, 2.0, 2.0]])
    POSTERIOR = jnp.array([[0.0, 2.0, 9.0], [2.0, 2.0, 1.0]])
    # Experience: (0, 0), (0, 1) and, with a reward, (1, 2); errors 1, −2 and 1.
    STEPS = steps_of((0, 0, 0, 0.9, 1, 1), (0, 1, 0, 0.9, 0, 0.5), (0, 1, 0, 0.9, 0, 0.5), (1, 2, 1, 0, 0, 1))

    @pytest.mark.parametrize(
        ("reward_weight", "advantage_weight", "expected"),
        [
            (1.0, 0.0, (1 + 4 + 1) / 3),
            (5.0, 0.0, (1 + 4 + 5 * 1) / 7),
            # In state 0 the errors differ from their mean −½ by ±1.5; in state 1 there is only one.
            (1.0, 2.0, (1 + 4 + 1 + 2 * (2.25 + 2.25)) / 3),
        ],
    )
    def test_by_hand(self, reward_weight, advantage_weight, expected):
        result = table_distance(
            self.PRIOR, self.POSTERIOR, self.STEPS, reward_weight=reward_weight, advantage_weight=advantage_weight
        )
        assert float(result) == pytest.approx(expected)

    def test_the_posterior_is_a_constant(self):
        slope = jax.grad(
            lambda posterior: table_distance(self.PRIOR, posterior, self.STEPS, reward_weight=5.0, advantage_weight=2.0)
        )(self.POSTERIOR)
        assert largest(slope) == 0


class TestInnerLoss:
    """Eq. 5 on a table: each pair of state and action counts once, however often it occurs."""

    TABLE = jnp.array([[1.0, 2.0], [5.0, 3.0]])
    # Errors 0.5 + 0.9·5 − 1 = 4 for one pair; 1 − 3 = −2 and 0.9·2 − 3 = −1.2 for the other.
    STEPS = steps_of((0, 0, 0.5, 0.9, 1, 1.0), (1, 1, 1.0, 0.0, 0, 0.5), (1, 1, 0.0, 0.9, 0, 0.5))

    def test_by_hand(self):
        total = 16 + (4 + 1.44) / 2
        assert float(table_td_loss(self.TABLE, self.STEPS)) == pytest.approx(total / 2)
        assert float(mean_td_loss(self.TABLE, self.STEPS)) == pytest.approx(total / 2)  # two pairs

    def test_targets_are_constants(self):
        slope = jax.grad(table_td_loss)(self.TABLE, self.STEPS)
        np.testing.assert_allclose(slope, [[-4.0, 0.0], [0.0, 1.6]], rtol=1e-5)


def test_an_iteration_moves_theta_towards_the_posterior(meta, state, samples):
    loss, gradient = jax.jit(lambda theta: outer_gradient(meta, theta, samples))(state.theta)
    nearer = jax.tree.map(lambda p, g: p - 1e-3 * g, state.theta, gradient)
    assert float(jax.jit(lambda theta: outer_loss(meta, theta, samples))(nearer)) < float(loss)
