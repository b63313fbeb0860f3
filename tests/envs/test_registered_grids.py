"""The registered grid games: Gymnasium's checker, rendering, and the same transitions as the compiled ones."""

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import upslope
from support.plain_grids import draw, pick
from upslope.envs.grid import GridGame, GridState, read_map
from upslope.envs.map_text import write_map

TRAPPED = """
    S.#.
    .T..
    #..G
"""
DOWN, RIGHT = 1, 3


def make_grid(**settings):
    return gym.make("upslope/Grid-v0", **settings)


@pytest.mark.parametrize("settings", [{}, {"map": TRAPPED}, {"map": TRAPPED, "slip": 0.3}, {"flat": True}])
def test_gymnasium_s_checker_passes_without_warnings(settings, recwarn):
    env = make_grid(render_mode="rgb_array", **settings).unwrapped
    env.spec = gym.spec("upslope/Grid-v0")
    check_env(env)
    assert [str(warning.message) for warning in recwarn] == []


def test_every_cell_and_action_matches_the_compiled_game():
    host, params = make_grid(map=TRAPPED, trap_penalty=0.5), read_map(TRAPPED, trap_penalty=0.5)
    compiled = jax.jit(GridGame(3, 4, traps=True).step)
    tried = 0
    for cell in (0, 1, 3, 4, 6, 7, 9, 10):
        for action in range(4):
            host.reset(options={"cell": cell})
            obs, reward, terminated, truncated, _ = host.step(action)
            state = GridState(jnp.asarray(cell), jnp.asarray(0))
            *_, expected_reward, ended, _, info = compiled(jax.random.key(0), state, action, params)
            np.testing.assert_array_equal(obs, info["final_observation"])
            assert (reward, terminated, truncated) == (float(expected_reward), bool(ended), False)
            tried += 1
    assert tried == 32


def test_slipping_goes_to_both_sides_with_the_given_probability():
    env = make_grid(map="...\nS..\n..G", slip=0.4)
    env.reset(seed=0)
    visits = []
    for _ in range(2000):
        env.reset(options={"cell": 4})
        env.step(RIGHT)
        visits.append(env.unwrapped._cell)
    assert np.mean(np.array(visits) == 5) == pytest.approx(0.6, abs=0.04)
    assert np.mean(np.array(visits) == 1) == pytest.approx(0.2, abs=0.04)
    assert np.mean(np.array(visits) == 7) == pytest.approx(0.2, abs=0.04)


def test_a_task_of_a_family_becomes_an_environment():
    task = pick(draw(upslope.obstacle_maps(), 1), 0)
    text = write_map(task)
    again = read_map(text)
    for name in ("obstacles", "traps", "start", "goal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(task, name))
    obs, _ = make_grid(map=text).reset(seed=0)
    np.testing.assert_array_equal(obs, GridGame(8, 8).observe(task, task.start))


def test_a_prior_shapes_it():
    env = upslope.PotentialShaping(make_grid(map="S..\n..G"), lambda obs: float(obs[1, 2, 2]), gamma=0.9)
    env.reset(seed=0)
    rewards = [env.step(action)[1] for action in (DOWN, RIGHT, RIGHT)]
    assert rewards == pytest.approx([0.0, 0.0, 1.0])  # terminal states have no potential


def test_truncated_after_fifty_steps():
    env = make_grid()
    env.reset(seed=0)
    ends = [env.step(0)[2:4] for _ in range(50)]
    assert ends == [(False, False)] * 49 + [(False, True)]


def test_make_vec_and_rows_as_a_list():
    envs = gym.make_vec("upslope/Grid-v0", num_envs=2, map=["S.G"])
    obs, _ = envs.reset(seed=0)
    assert obs.shape == (2, 1, 3, 4)
    envs.step(np.array([RIGHT, RIGHT]))
    _, rewards, terminated, _, _ = envs.step(np.array([RIGHT, 2]))
    np.testing.assert_array_equal(rewards, [1.0, 0.0])
    np.testing.assert_array_equal(terminated, [True, False])


def test_rendering_shows_the_position():
    env = make_grid(map="S.G", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (40, 120, 3)
    assert before.dtype == np.uint8
    env.step(RIGHT)
    changed = np.flatnonzero(np.any(env.render() != before, axis=(0, 2)))
    assert changed.min() < 40 <= changed.max() < 80
    text_env = make_grid(map="S.G", render_mode="ansi").unwrapped
    text_env.reset(seed=0)
    text_env.step(RIGHT)
    assert text_env.render() == "S@G"
    assert make_grid(map="S.G").unwrapped.render() is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"map": "S.\n..G"}, "same number"),
        ({"map": "S.X.G"}, "'X'"),
        ({"map": "S.."}, "0 cells with G"),
        ({"map": "SSG"}, "2 cells with S"),
        ({"map": "S.G", "slip": 1.0}, "probability below 1"),
        ({"map": "S.G", "trap_penalty": -1.0}, "traps cost something"),
    ],
)
def test_invalid_maps(settings, words):
    with pytest.raises(upslope.UpslopeError, match=words):
        make_grid(**settings)


def test_an_episode_cannot_start_in_an_obstacle():
    with pytest.raises(upslope.UpslopeError, match="give a free one of the 3 cells"):
        make_grid(map="S#G").reset(options={"cell": 1})
