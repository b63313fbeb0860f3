"""Exact planning: by hand, against breadth-first distances, against the reference planner, and on many maps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.mdps import greedy_sets, random_mdp, solve
from support.plain_grids import as_board, distances, draw, pick
from support.planning import tabulate, value_iteration
from upslope.envs.grid import GridGame, read_map
from upslope.envs.grid_rules import DOWN, LEFT, RIGHT, UP
from upslope.planning.exact import (
    TabularMDP,
    best_actions,
    evaluate_policy,
    immediate_rewards,
    shape_mdp,
    solve_all,
)
from upslope.tasks import grid_games

GAMMA = 0.9


def table(mdp) -> TabularMDP:
    """A random MDP of the reference planner as upslope's tables: every state is an outcome of every action."""
    states, actions = mdp.chances.shape[:2]
    return TabularMDP(
        jnp.broadcast_to(jnp.arange(states), (states, actions, states)),
        jnp.asarray(mdp.chances),
        jnp.asarray(mdp.rewards),
        jnp.broadcast_to(jnp.asarray(mdp.discount), mdp.chances.shape),
        jnp.asarray(~mdp.terminal),
    )


class TestByHand:
    one = read_map("""
        S.#
        .#G
        ...
    """)

    def test_a_hand_solved_map(self):
        # The only way: down, down, right, right, up. Five steps, so 0.9⁴ in the start.
        found = value_iteration(tabulate(GridGame(3, 3), self.one, GAMMA))
        g = GAMMA
        expected = [g**4, g**5, 0, g**3, 0, 0, g**2, g, 1]
        np.testing.assert_allclose(found.value, expected, rtol=1e-6)
        assert float(found.residual) == 0
        in_start = [g**5, g**4, g**5, g**6]  # up stays, down is right, left stays, right leads away
        np.testing.assert_allclose(found.action_value[0], in_start, rtol=1e-6)
        best = np.asarray(best_actions(found.action_value))
        assert [np.flatnonzero(best[cell]).tolist() for cell in (0, 1, 3, 6, 7, 8)] == [
            [DOWN], [LEFT], [DOWN], [RIGHT], [RIGHT], [UP],
        ]  # fmt: skip

    def test_a_trap_is_walked_around(self):
        # Two ways to the goal: three steps through the trap, or five around it.
        one = read_map("""
            ST.G
            ....
        """)
        found = value_iteration(tabulate(GridGame(2, 4, traps=True), one, GAMMA))
        assert float(found.value[0]) == pytest.approx(GAMMA**4)
        assert float(found.action_value[0, RIGHT]) == -1.0
        assert float(found.value[1]) == 0.0, "nothing can be done in a trap"

    def test_a_slippery_corridor(self):
        # In a corridor of one row up and down do not move, and a slip costs time: one step away V = (1 − p)/(1 − γp).
        one = read_map("S.G", slip=0.4)
        found = value_iteration(tabulate(GridGame(1, 3, slippery=True), one, GAMMA))
        ahead = 0.6 / (1 - 0.4 * GAMMA)
        np.testing.assert_allclose(found.value, [GAMMA * ahead**2, ahead, 0], rtol=1e-5)

    def test_all_of_several_best_actions(self):
        scores = jnp.asarray([[1.0, 1.0 - 1e-7, 0.9, 0.0], [0.0, 0.0, 0.0, 0.0]])
        np.testing.assert_array_equal(best_actions(scores), [[True, True, False, False], [True] * 4])


class TestAgainstBreadthFirstSearch:
    def test_values_are_gamma_to_the_distance(self):
        family = grid_games((5, 12), obstacles=0.35)
        maps = draw(family, 60)
        found = jax.tree.map(np.asarray, solve_all(family.env, maps, GAMMA))
        for index in range(60):
            steps = distances(as_board(pick(maps, index))).ravel()
            expected = np.where(steps > 0, GAMMA ** (steps - 1.0), 0.0)
            np.testing.assert_allclose(found.value[index], expected, rtol=1e-5)
        np.testing.assert_array_equal(found.residual, 0)

    def test_optimal_actions_are_those_that_lead_one_step_nearer(self):
        family = grid_games((5, 12), obstacles=0.35)
        maps = draw(family, 60)
        found = solve_all(family.env, maps, GAMMA)
        best = np.asarray(best_actions(found.action_value))
        tables = jax.jit(jax.vmap(lambda one: family.env.outcomes(one).successors))(maps)
        several = 0
        for index in range(60):
            steps = distances(as_board(pick(maps, index))).ravel()
            successors = np.asarray(tables[index])[..., 0]
            for cell in np.flatnonzero(steps > 0):
                np.testing.assert_array_equal(best[index, cell], steps[successors[cell]] == steps[cell] - 1)
                several += best[index, cell].sum() > 1
        assert several > 100


class TestAgainstTheReferee:
    @pytest.mark.parametrize("seed", range(5))
    def test_random_mdps(self, seed):
        with jax.enable_x64(True):
            mdp = random_mdp(seed, gamma=GAMMA)
            found, expected = value_iteration(table(mdp), tolerance=1e-13), solve(mdp)
            np.testing.assert_allclose(found.value[mdp.ordinary], expected.v[mdp.ordinary], atol=1e-11)
            np.testing.assert_allclose(found.action_value[mdp.ordinary], expected.q[mdp.ordinary], atol=1e-11)
            best = best_actions(found.action_value, relative=0.0, absolute=1e-8)
            np.testing.assert_array_equal(best[mdp.ordinary], greedy_sets(mdp, expected.q))

    def test_the_value_of_a_policy_by_linear_algebra(self):
        with jax.enable_x64(True):
            mdp = random_mdp(7, gamma=GAMMA)
            policy = np.random.default_rng(0).dirichlet(np.ones(3), size=8)
            moves = np.einsum("sa,sat->st", policy, mdp.chances) * mdp.discount
            gains = np.einsum("sa,sat,sat->s", policy, mdp.chances, mdp.rewards)
            moves[mdp.terminal], gains[mdp.terminal] = 0, 0
            expected = np.linalg.solve(np.eye(8) - moves, gains)
            found = evaluate_policy(table(mdp), jnp.asarray(policy), tolerance=1e-14)
            np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_the_optimal_policy_is_worth_the_optimal_value(self):
        family = grid_games(slip=0.2, traps=0.1)
        mdp = tabulate(family.env, pick(draw(family, 1000), 0), GAMMA)
        found = value_iteration(mdp)
        greedy = jax.nn.one_hot(jnp.argmax(found.action_value, axis=-1), 4)
        np.testing.assert_allclose(evaluate_policy(mdp, greedy), found.value, atol=2e-6)

    def test_shaping_adds_f_where_one_acts(self):
        with jax.enable_x64(True):
            mdp = random_mdp(3, gamma=GAMMA)
            potential = np.random.default_rng(1).normal(size=8)
            shaped = shape_mdp(table(mdp), jnp.asarray(potential))
            added = mdp.discount * potential - potential[:, None]  # F(s, s')
            expected = mdp.rewards + np.where(mdp.terminal[:, None], 0.0, added)[:, None]
            np.testing.assert_allclose(shaped.rewards, expected, atol=1e-12)
            np.testing.assert_allclose(immediate_rewards(shaped), np.sum(mdp.chances * expected, axis=-1), atol=1e-12)


class TestInBulk:
    def test_thousands_at_once_are_the_same_as_one_by_one(self):
        family = grid_games(slip=0.2, traps=0.1)
        maps = draw(family, 1000)
        every = solve_all(family.env, maps, GAMMA)
        for index in (0, 999):
            alone = value_iteration(tabulate(family.env, pick(maps, index), GAMMA))
            np.testing.assert_allclose(every.value[index], alone.value, atol=1e-6)
            np.testing.assert_allclose(every.action_value[index], alone.action_value, atol=1e-6)
            # Rounding differs between the two, and may cost the last sweep.
            assert abs(int(every.iterations[index]) - int(alone.iterations)) <= 1

    def test_iterations_are_bounded(self):
        mdp = tabulate(GridGame(1, 3), read_map("S.G"), GAMMA)
        found = value_iteration(mdp, max_iterations=1)
        assert (int(found.iterations), float(found.residual)) == (1, 1.0)
        np.testing.assert_array_equal(found.value, [0, 1, 0])
