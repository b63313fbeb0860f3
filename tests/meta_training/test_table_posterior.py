"""The posterior as a table: backups, maps solved by many steps, DQN as a special case."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import small_network
from support.comparing import assert_trees_close, largest
from support.finite import steps_of
from support.meta import outer_gradient
from upslope.equations.losses import td_loss
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.posteriors import TablePosterior
from upslope.meta_training.posteriors.finite import FiniteSamples, Steps
from upslope.meta_training.recipes import for_grid_games, multi_task_dqn
from upslope.planning.exact import solve_all, tabulate

MAPS, CELLS, ACTIONS = 2, 12, 4


def adapted(table, steps, step_size, *, inner_steps=1):
    """The posterior that starts from a given table."""
    posterior = TablePosterior(inner_step_size=step_size, inner_steps=inner_steps)
    return posterior.adapt(small_network(), FiniteSamples(jnp.zeros((len(table), 3)), steps, table))


class TestInnerSteps:
    def test_one_step_of_size_one_is_a_bellman_backup(self):
        table = jnp.array([[1.0, 2.0], [5.0, 3.0]])
        steps = steps_of((0, 0, 0.5, 0.9, 1, 1.0), (1, 1, 1.0, 0.0, 0, 1.0))
        result = adapted(table, steps, 1.0)
        np.testing.assert_allclose(result, [[0.5 + 0.9 * 5, 2.0], [5.0, 1.0]], rtol=1e-6)

    def test_a_pair_with_two_outcomes_moves_to_their_mean(self):
        table = jnp.array([[0.0, 2.0], [4.0, 0.0]])
        steps = steps_of((0, 0, 1.0, 0.5, 1, 0.5), (0, 0, 0.0, 0.0, 1, 0.5))
        result = adapted(table, steps, 0.5)
        # Targets 1 + 0.5·4 = 3 and 0, their mean 1.5; half the way from 0.
        np.testing.assert_allclose(result, [[0.75, 2.0], [4.0, 0.0]], rtol=1e-6)

    def test_many_steps_on_all_pairs_solve_the_map(self, maps, tasks):
        solution = solve_all(maps.env, tasks, maps.gamma)
        for index in range(MAPS):
            mdp = tabulate(maps.env, jax.tree.map(lambda leaf, i=index: leaf[i], tasks), maps.gamma)
            cell, action = np.nonzero(np.broadcast_to(mdp.acting[:, None], (CELLS, ACTIONS)))
            at = (cell, action, 0)
            steps = Steps(
                jnp.asarray(cell, jnp.int32), jnp.asarray(action, jnp.int32), mdp.rewards[at], mdp.discounts[at],
                mdp.successors[at], jnp.ones(len(cell)),
            )  # fmt: skip
            start = jax.random.normal(jax.random.key(5), (CELLS, ACTIONS))
            result = adapted(start, steps, 1.0, inner_steps=150)
            where = np.asarray(mdp.acting)
            np.testing.assert_allclose(result[where], solution.action_value[index][where], atol=1e-4)


def test_without_a_target_network_it_starts_at_q_theta(theta, observations):
    steps = steps_of((0, 1, 0.5, 0.9, 3, 1.0))
    result = TablePosterior(inner_step_size=1.0).adapt(theta, FiniteSamples(observations, steps, None))
    q = jax.vmap(theta)(observations)
    np.testing.assert_allclose(result, q.at[0, 1].set(0.5 + 0.9 * q[3].max()), rtol=1e-5)


@pytest.mark.slow
def test_multi_task_dqn_has_the_gradient_of_dqn(maps, state, samples):
    """One backup of the averaged network and Eq. 7 equal Eq. 5 with a frozen target."""
    config = dataclasses.replace(multi_task_dqn(4), hidden=(8, 8)).with_posterior(reward_weight=1.0)
    meta = MetaTraining(maps, config)
    target = jax.jit(lambda: MetaTraining(maps, config).init(jax.random.key(9)))().theta
    one = jax.tree.map(lambda leaf: leaf[:1], samples)

    @jax.jit
    def both(theta):
        _, ours = outer_gradient(
            meta, theta, config.posterior.draw(jax.random.split(jax.random.key(0), 1), one, target)
        )
        steps, seen = jax.tree.map(lambda leaf: leaf[0], one.steps), one.observations[0]
        # Each pair counts once, as in the table.
        first = jnp.zeros((CELLS, ACTIONS), jnp.int32).at[steps.state, steps.action].set(jnp.arange(len(steps.state)))
        weights = (first[steps.state, steps.action] == jnp.arange(len(steps.state))).astype(jnp.float32)

        def loss(network):
            q, next_value = jax.vmap(network)(seen), jax.vmap(target)(seen).max(axis=-1)
            losses = jax.vmap(td_loss)(
                q[steps.state, steps.action], steps.reward, steps.discount, next_value[steps.successor]
            )
            return jnp.sum(weights * losses) / jnp.sum(weights)

        return ours, jax.grad(loss)(theta)

    ours, theirs = both(state.theta)
    assert largest(theirs) > 1e-3
    assert_trees_close(ours, theirs, rtol=2e-3, atol=1e-5)


def test_the_control_differs_only_in_the_settings_of_dqn():
    ours, theirs = for_grid_games(), multi_task_dqn()
    assert dataclasses.replace(theirs, posterior=ours.posterior) == ours
    ours, theirs = dataclasses.asdict(ours.posterior), dataclasses.asdict(theirs.posterior)
    assert {name for name in ours if ours[name] != theirs[name]} == {"inner_steps", "target_decay", "advantage_weight"}
