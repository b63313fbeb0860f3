"""The reported returns of learners: exact on maps and equal to rollouts; sampled elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.plain_grids import draw, pick
from support.scores import Scores
from upslope.envs.grid import read_map
from upslope.learners.evaluation import exact_report, greedy_report
from upslope.learners.policies import Greedy
from upslope.planning.exact import tabulate, value_iteration
from upslope.planning.measures import episode_values
from upslope.tasks import cartpoles, grid_games

FAMILY = grid_games((4, 4), max_steps=12)


@pytest.fixture(scope="module")
def maps():
    return jax.tree.map(jnp.asarray, draw(FAMILY, 30))


def by_table(q):
    """A greedy policy from a Q-table over cells."""
    return Greedy(Scores(lambda obs: q[FAMILY.env.state_number(obs)]))


def test_the_report_equals_a_rollout(maps):
    tables = jnp.asarray(np.random.default_rng(1).normal(size=(30, 16, 4)), jnp.float32)

    @jax.jit
    @jax.vmap
    def both(task, q):
        alone = jax.tree.map(lambda leaf: leaf[None], task)
        rollout_return = FAMILY.returns(jax.random.key(2), alone, by_table(q))[0]
        return exact_report(FAMILY, task, by_table(q)), rollout_return

    exact, rollout_return = both(maps, tables)
    np.testing.assert_array_equal(exact["return"], rollout_return)
    assert 0 < exact["return"].sum() < 30


def test_the_optimal_policy_earns_the_optimal_value(maps):
    @jax.jit
    def plan(task):
        solution = value_iteration(tabulate(FAMILY.env, task, FAMILY.gamma))
        return solution, exact_report(FAMILY, task, by_table(solution.action_value))

    for index in range(5):
        task = pick(maps, index)
        solution, report = plan(task)
        assert float(report["return"]) == 1.0
        assert float(report["discounted_return"]) == pytest.approx(float(solution.value[task.start]), rel=1e-5)


def test_an_episode_ends_at_the_step_limit():
    task = read_map("S...G")
    mdp = tabulate(grid_games((1, 5)).env, task, 0.9)
    right = jax.nn.one_hot(jnp.full(5, 3), 4)
    for steps, raw in ((3, 0.0), (4, 1.0)):
        undiscounted, discounted = episode_values(mdp, right, steps)
        assert float(undiscounted[0]) == raw
        assert float(discounted[0]) == pytest.approx(raw * 0.9**3, rel=1e-6)


def test_a_trap_costs_its_penalty():
    task = read_map("STG", trap_penalty=0.5)
    family = grid_games((1, 3), traps=0.1, gamma=0.8)
    report = exact_report(family, task, Greedy(Scores(lambda obs: jnp.asarray([0.0, 0.0, 0.0, 1.0]))))
    assert float(report["return"]) == -0.5


def test_poles_are_evaluated_by_rollouts():
    family = cartpoles()
    task = family.sample(jax.random.key(0))
    policy = Greedy(Scores(lambda obs: obs[2:3] * jnp.asarray([-1, 1]), 2))
    report = greedy_report(jax.random.key(1), family, task, policy, 2)
    assert set(report) == {"return"}
    assert 1 <= float(report["return"]) <= 200
