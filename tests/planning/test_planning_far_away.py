"""Exact planning with small values: long corridors, small γ, traps next to them, and sums that cancel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.plain_grids import as_board, distances, draw, pick
from support.planning import tabulate, value_iteration
from upslope.envs.grid import GridGame, read_map
from upslope.envs.grid_rules import RIGHT
from upslope.planning.exact import (
    TabularMDP,
    best_actions,
    can_earn,
    evaluate_policy,
    shape_mdp,
    steps_to_reward,
)
from upslope.planning.measures import truth, truths
from upslope.tasks import grid_games

CORRIDOR = read_map("S" + 198 * "." + "G")
#: From every cell of it but the goal.
STEPS = np.arange(199, 0, -1)
ONLY_RIGHT = np.eye(4, dtype=bool)[np.full(199, RIGHT)]


class TestACorridorOf200Cells:
    def test_the_value_reaches_the_far_end(self):
        known = truth(GridGame(1, 200), CORRIDOR, 0.9)
        np.testing.assert_allclose(known.solution.value[:199], 0.9 ** (STEPS - 1.0), rtol=3e-5)
        np.testing.assert_array_equal(best_actions(known.solution.action_value)[:199], ONLY_RIGHT)
        np.testing.assert_array_equal(known.states, np.arange(200) < 199)
        # 199 iterations to spread, and one to see that nothing changes.
        assert (int(known.solution.iterations), float(known.solution.residual)) == (200, 0)

    def test_a_policy_s_value_does_too(self):
        mdp = tabulate(GridGame(1, 200), CORRIDOR, 0.9)
        right = jax.nn.one_hot(jnp.full(200, RIGHT), 4)
        np.testing.assert_allclose(evaluate_policy(mdp, right)[:199], 0.9 ** (STEPS - 1.0), rtol=3e-5)

    def test_beside_traps(self):
        # Q of the traps is −1, V as small as 1e-9.
        one = read_map("S" + 198 * "." + "G\n" + 200 * "T")
        found = value_iteration(tabulate(GridGame(2, 200, traps=True), one, 0.9))
        np.testing.assert_allclose(found.value[:199], 0.9 ** (STEPS - 1.0), rtol=3e-5)
        np.testing.assert_array_equal(best_actions(found.action_value)[:199], ONLY_RIGHT)

    def test_with_slippery_moves(self):
        # As in a short corridor: each step ahead costs a factor of γ·(1 − p)/(1 − γp).
        one = read_map("S" + 198 * "." + "G", slip=0.4)
        found = value_iteration(tabulate(GridGame(1, 200, slippery=True), one, 0.9))
        ahead = 0.6 / (1 - 0.4 * 0.9)
        np.testing.assert_allclose(found.value[:199], ahead * (0.9 * ahead) ** (STEPS - 1.0), rtol=1e-4)
        np.testing.assert_array_equal(best_actions(found.action_value)[:199], ONLY_RIGHT)

    def test_what_is_too_small_for_single_precision_can_still_be_earned(self):
        known = truth(GridGame(1, 200), CORRIDOR, 0.5)
        assert float(known.solution.value[0]) == 0, "2⁻¹⁹⁸ is no float32"
        np.testing.assert_array_equal(known.states, np.arange(200) < 199)

    def test_and_is_found_in_double_precision(self):
        with jax.enable_x64(True):
            found = value_iteration(tabulate(GridGame(1, 200), read_map("S" + 198 * "." + "G"), 0.5))
            np.testing.assert_array_equal(found.value[:199], 0.5 ** (STEPS - 1.0))
            np.testing.assert_array_equal(best_actions(found.action_value)[:199], ONLY_RIGHT)


@pytest.mark.parametrize("gamma", [0.05, *(pytest.param(gamma, marks=pytest.mark.slow) for gamma in (0.4, 0.5)), 0.99])
@pytest.mark.parametrize("obstacles", [0.0, 0.3])
def test_any_discount_against_breadth_first_distances(gamma, obstacles):
    family = grid_games((10, 10), obstacles=obstacles, gamma=gamma)
    maps = draw(family, 40)
    known = truths(family.env, maps, gamma)
    best = np.asarray(best_actions(known.solution.action_value))
    successors = np.asarray(known.mdp.successors)[..., 0]
    for index in range(40):
        steps = distances(as_board(pick(maps, index))).ravel()
        np.testing.assert_array_equal(known.states[index], steps > 0)
        expected = np.where(steps > 0, gamma ** np.maximum(steps - 1.0, 0), 0.0)
        np.testing.assert_allclose(known.solution.value[index], expected, rtol=1e-5)
        for cell in np.flatnonzero(steps > 0):
            nearer = steps[successors[index, cell]] == steps[cell] - 1
            np.testing.assert_array_equal(best[index, cell], nearer)


def test_more_cells_than_iterations_are_granted_otherwise(monkeypatch):
    monkeypatch.setattr("upslope.planning.exact.PATIENCE", 10)
    found = value_iteration(tabulate(GridGame(1, 50), read_map("S" + 48 * "." + "G"), 0.9))
    assert float(found.value[0]) == pytest.approx(0.9**48, rel=1e-5)


def test_sums_that_cancel_come_to_an_end():
    """With Φ = V* all values are zero up to rounding, so a relative tolerance has no meaning."""
    family = grid_games((6, 6), traps=0.1, slip=0.2)
    mdp = tabulate(family.env, pick(draw(family, 1), 0), 0.9)
    found = value_iteration(mdp)
    shaped = value_iteration(shape_mdp(mdp, found.value))
    assert int(shaped.iterations) < 200
    np.testing.assert_allclose(shaped.value, 0, atol=1e-5)
    best = best_actions(shaped.action_value, relative=0.0, absolute=1e-5)
    np.testing.assert_array_equal(best, best_actions(found.action_value, relative=0.0, absolute=1e-5))


def test_values_that_shrink_for_good_end_at_the_limit():
    """Staying earns nothing forever; leaving earns 1 at once and loses 0.2 in every later step.

    With n steps to go, staying until the last and then leaving is worth γ^(n − 1), in the limit nothing.
    """
    mdp = TabularMDP(
        successors=jnp.array([[[0], [1]], [[1], [1]]]),
        probabilities=jnp.ones((2, 2, 1)),
        rewards=jnp.array([[[0.0], [1.0]], [[-0.2], [-0.2]]]),
        discounts=jnp.full((2, 2, 1), 0.9),
        acting=jnp.ones(2, bool),
    )
    found = value_iteration(mdp, max_iterations=500)
    assert int(found.iterations) == 500
    np.testing.assert_allclose(found.value, [0.9**499, -2], rtol=1e-4)
    np.testing.assert_array_equal(best_actions(found.action_value)[0], [True, False])
    assert int(value_iteration(mdp).iterations) < 1000, "single precision knows no smaller values"


def test_where_one_can_earn():
    # The agent does not act in the trap and at the goal; behind the wall there is no path.
    mdp = tabulate(GridGame(1, 6, traps=True), read_map("TS.G#."), 0.9)
    np.testing.assert_array_equal(can_earn(mdp), [False, True, True, False, False, False])
    np.testing.assert_array_equal(steps_to_reward(mdp), [-1, 2, 1, -1, -1, -1])
