"""The registered grid games: Gymnasium's own checks, pictures, and the very transitions of the compiled ones."""

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


def made(**settings):
    return gym.make("upslope/Grid-v0", **settings)


@pytest.mark.parametrize("settings", [{}, {"map": TRAPPED}, {"map": TRAPPED, "slip": 0.3}, {"flat": True}])
def test_gymnasium_s_checker_has_nothing_to_say(settings, recwarn):
    env = made(render_mode="rgb_array", **settings).unwrapped
    env.spec = gym.spec("upslope/Grid-v0")
    check_env(env)
    assert [str(warning.message) for warning in recwarn] == []


def test_every_cell_and_action_as_in_the_compiled_game():
    host, params = made(map=TRAPPED, trap_penalty=0.5), read_map(TRAPPED, trap_penalty=0.5)
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
    env = made(map="...\nS..\n..G", slip=0.4)
    env.reset(seed=0)
    seen = []
    for _ in range(2000):
        env.reset(options={"cell": 4})
        env.step(RIGHT)
        seen.append(env.unwrapped._cell)
    assert np.mean(np.array(seen) == 5) == pytest.approx(0.6, abs=0.04)
    assert np.mean(np.array(seen) == 1) == pytest.approx(0.2, abs=0.04)
    assert np.mean(np.array(seen) == 7) == pytest.approx(0.2, abs=0.04)


def test_a_task_of_a_family_becomes_an_environment():
    task = pick(draw(upslope.obstacle_maps(), 1), 0)
    text = write_map(task)
    again = read_map(text)
    for name in ("obstacles", "traps", "start", "goal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(task, name))
    obs, _ = made(map=text).reset(seed=0)
    np.testing.assert_array_equal(obs, GridGame(8, 8).observe(task, task.start))


def test_a_prior_shapes_it():
    env = upslope.PotentialShaping(made(map="S..\n..G"), lambda obs: float(obs[1, 2, 2]), gamma=0.9)
    env.reset(seed=0)
    rewards = [env.step(action)[1] for action in (DOWN, RIGHT, RIGHT)]
    assert rewards == pytest.approx([0.0, 0.0, 1.0])  # terminal states have no potential


def test_truncated_after_fifty_steps():
    env = made()
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


def test_pictures_and_text_show_where_one_stands():
    env = made(map="S.G", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (40, 120, 3)
    assert before.dtype == np.uint8
    env.step(RIGHT)
    changed = np.flatnonzero(np.any(env.render() != before, axis=(0, 2)))
    assert changed.min() < 40 <= changed.max() < 80
    written = made(map="S.G", render_mode="ansi").unwrapped
    written.reset(seed=0)
    written.step(RIGHT)
    assert written.render() == "S@G"
    assert made(map="S.G").unwrapped.render() is None


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
def test_texts_that_are_not_maps(settings, words):
    with pytest.raises(upslope.UpslopeError, match=words):
        made(**settings)


def test_an_episode_begins_where_something_can_be_done():
    with pytest.raises(upslope.UpslopeError, match="give a free one of the 3 cells"):
        made(map="S#G").reset(options={"cell": 1})
