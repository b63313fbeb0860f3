"""Grid games: every cell and action against a plain re-implementation; ends of episodes; observations; slipping."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.plain_grids import as_board, draw, pick, plain_outcomes
from upslope.envs.grid import GridGame, GridState, read_map
from upslope.envs.grid_rules import GOAL, OBSTACLES, POSITION, START, TRAPS
from upslope.tasks import grid_games

SMALL = read_map("""
    S.#.
    .T..
    #..G
""")
GAME = GridGame(3, 4, traps=True)
step = jax.jit(GAME.step)


def one_step(cell, action, time=0, params=SMALL):
    return step(jax.random.key(0), GridState(jnp.asarray(cell), jnp.asarray(time)), jnp.asarray(action), params)


class TestTransitions:
    @pytest.mark.parametrize(
        "family",
        [
            grid_games((8, 8)),
            grid_games((3, 11), obstacles=0.4),
            grid_games((10, 10), obstacles=0.0),
            grid_games((6, 5), traps=0.2, trap_penalty=0.5),
            grid_games((5, 6), traps=0.1, slip=0.4),
        ],
        ids=["8x8", "3x11", "clean 10x10", "traps", "traps and slipping"],
    )
    def test_every_cell_and_action_matches_plain_python(self, family):
        env, maps = family.env, draw(family, 4)
        tables = jax.tree.map(np.asarray, jax.jit(jax.vmap(env.outcomes))(maps))
        acted = 0
        for index in range(4):
            board = as_board(pick(maps, index))
            penalty, slip = float(maps.trap_penalty[index]), float(maps.slip[index])
            for cell in range(env.cells):
                row, column = divmod(cell, env.width)
                assert tables.acting[index, cell] == (board[row][column] == ".")
                if board[row][column] != ".":
                    assert np.all(tables.successors[index, cell] == cell)
                    assert np.all(tables.rewards[index, cell] == 0)
                    assert np.all(tables.terminated[index, cell])
                    continue
                for action in range(4):
                    expected = plain_outcomes(board, row, column, action, slip=slip, penalty=penalty)
                    result = as_dictionary(tables, env.width, index, cell, action)
                    assert result.keys() == expected.keys()
                    for there, outcome in expected.items():
                        assert result[there] == pytest.approx(outcome)
                    acted += 1
        assert acted > 150

    def test_steps_match_the_tables(self):
        tables = jax.tree.map(np.asarray, GAME.outcomes(SMALL))
        for cell in np.flatnonzero(tables.acting):
            for action in range(4):
                _, _, reward, terminated, truncated, info = one_step(cell, action)
                there = np.flatnonzero(np.asarray(info["final_observation"])[..., POSITION])
                assert there == tables.successors[cell, action, 0]
                assert float(reward) == tables.rewards[cell, action, 0]
                assert bool(terminated) == tables.terminated[cell, action, 0]
                assert not truncated


def as_dictionary(tables, width, index, cell, action):
    """The tables' outcomes of one action, with equal successors merged."""
    result = {}
    for chance, there, reward, over in zip(
        *(leaf[index, cell, action] for leaf in (tables.probabilities, tables.successors, tables.rewards)),
        tables.terminated[index, cell, action],
        strict=True,
    ):
        key = divmod(int(there), width)
        result[key] = (result.get(key, (0.0,))[0] + float(chance), float(reward), bool(over))
    return {key: value for key, value in result.items() if value[0] > 0}


class TestEndsOfEpisodes:
    # Cells of SMALL: 0 1 2 3 / 4 5 6 7 / 8 9 10 11; the goal is 11, the trap 5.
    @pytest.mark.parametrize(
        ("cell", "action", "there", "reward", "terminated"),
        [
            pytest.param(10, 3, 11, 1.0, True, id="goal"),
            pytest.param(1, 1, 5, -1.0, True, id="trap"),
            pytest.param(1, 3, 1, 0.0, False, id="obstacle"),
            pytest.param(0, 0, 0, 0.0, False, id="upper border"),
            pytest.param(4, 2, 4, 0.0, False, id="left border"),
            pytest.param(3, 3, 3, 0.0, False, id="right border"),
            pytest.param(9, 1, 9, 0.0, False, id="lower border"),
            pytest.param(6, 1, 10, 0.0, False, id="free cell"),
        ],
    )
    def test_by_hand(self, cell, action, there, reward, terminated):
        _, following, result, ended, truncated, info = one_step(cell, action)
        position = np.asarray(info["final_observation"])[..., POSITION].ravel()
        np.testing.assert_array_equal(position, np.eye(12)[there])
        assert (float(result), bool(ended), bool(truncated)) == (reward, terminated, False)
        assert int(following.cell) == (0 if terminated else there)
        assert int(following.time) == (0 if terminated else 1)

    @pytest.mark.parametrize(("time", "expected"), [(48, False), (49, True)])
    def test_fifty_steps_are_truncation(self, time, expected):
        obs, following, _, terminated, truncated, info = one_step(6, 0, time)
        assert (bool(truncated), bool(terminated)) == (expected, False)
        assert int(following.cell) == (0 if expected else 6)
        assert np.flatnonzero(np.asarray(info["final_observation"])[..., POSITION]) == 6
        assert np.flatnonzero(np.asarray(obs)[..., POSITION]) == int(following.cell)

    def test_the_goal_on_the_last_step_is_termination(self):
        _, _, reward, terminated, truncated, _ = one_step(10, 3, time=49)
        assert (float(reward), bool(terminated), bool(truncated)) == (1.0, True, False)


class TestObservations:
    def test_channels_by_hand(self):
        obs = np.asarray(GAME.observe(SMALL, jnp.asarray(6)))
        assert obs.shape == (3, 4, 5)
        result = {channel: np.flatnonzero(obs[..., channel]).tolist() for channel in range(5)}
        assert result == {START: [0], GOAL: [11], POSITION: [6], OBSTACLES: [2, 8], TRAPS: [5]}
        assert set(np.unique(obs)) == {0.0, 1.0}

    def test_four_channels_without_traps(self):
        game = GridGame(3, 4)
        np.testing.assert_array_equal(game.observe(SMALL, jnp.asarray(6)), GAME.observe(SMALL, jnp.asarray(6))[..., :4])
        assert game.observation_shape == (3, 4, 4)

    def test_all_cells_at_once(self):
        every = GAME.observe_all(SMALL)
        for cell in range(12):
            np.testing.assert_array_equal(every[cell], GAME.observe(SMALL, jnp.asarray(cell)))

    def test_flat_observations_are_the_same_numbers(self):
        flat = GridGame(3, 4, traps=True, flat=True)
        assert flat.observation_shape == (60,)
        np.testing.assert_array_equal(
            flat.observe(SMALL, jnp.asarray(6)), np.asarray(GAME.observe(SMALL, jnp.asarray(6))).ravel()
        )

    def test_episodes_start_at_the_start_cell(self):
        obs, state = GAME.reset(jax.random.key(3), SMALL)
        np.testing.assert_array_equal(obs, GAME.observe(SMALL, SMALL.start))
        assert (int(state.cell), int(state.time)) == (0, 0)


class TestSlipping:
    room = read_map("...\n...\n...\nS.G", slip=0.4)

    def landings(self, action, count=4000):
        """The share of steps from the middle of the room that reach each cell."""
        game = GridGame(4, 3, slippery=True)
        start = GridState(jnp.asarray(4), jnp.asarray(0))
        keys = jax.random.split(jax.random.key(action), count)
        _, following, *_ = jax.jit(jax.vmap(game.step, (0, None, None, None)))(
            keys, start, jnp.asarray(action), self.room
        )
        return np.bincount(following.cell, minlength=12) / count

    @pytest.mark.parametrize(
        ("action", "ahead", "sides"), [(0, 1, (3, 5)), (1, 7, (3, 5)), (2, 3, (1, 7)), (3, 5, (1, 7))]
    )
    def test_half_of_the_slips_go_to_each_side(self, action, ahead, sides):
        expected = np.zeros(12)
        expected[ahead], expected[list(sides)] = 0.6, 0.2
        np.testing.assert_allclose(self.landings(action), expected, atol=0.03)  # 4 standard deviations

    def test_a_game_that_is_not_slippery_ignores_the_probability(self):
        game = GridGame(4, 3)
        start = GridState(jnp.asarray(4), jnp.asarray(0))
        cells = {int(game.step(jax.random.key(s), start, jnp.asarray(0), self.room)[1].cell) for s in range(10)}
        assert cells == {1}
