"""Φ is evaluated only where it is needed: not at terminal states, and not while shaping is switched off."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from support.scripted import EPISODES, GAMMA, F, Scripted, level
from upslope import PotentialShaping as Single
from upslope.wrappers.vector import PotentialShaping

SHIFTED = (EPISODES[1], EPISODES[2], EPISODES[0])
TERMINAL = (3.0, 6.0)  # the levels where the scripts terminate


def one(obs):
    return np.nan if obs[0] in TERMINAL else obs[0]


def batch(obs):
    return np.where(np.isin(obs[:, 0], TERMINAL), np.nan, obs[:, 0])


def vector(mode, potential, *scripts, **settings):
    subs = [lambda script=script: Scripted(*script) for script in scripts or (EPISODES, SHIFTED)]
    env = PotentialShaping(SyncVectorEnv(subs, autoreset_mode=mode), potential, GAMMA, **settings)
    env.reset(seed=0)
    return env


def play(env, steps=9):
    """F of every step; with autoreset disabled, ended environments are reset by a mask."""
    added = []
    for _ in range(steps):
        _, _, terminated, truncated, infos = env.step(np.zeros(env.num_envs, int))
        added.append(infos["shaping_reward"])
        done = terminated | truncated
        if env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and done.any():
            env.reset(options={"reset_mask": done})
    return np.array(added)


@pytest.mark.parametrize("potential", [one, batch])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_undefined_at_terminal_states_gives_the_same_f(mode, potential):
    added = play(vector(mode, potential))
    np.testing.assert_array_equal(added, play(vector(mode, level)))
    np.testing.assert_allclose(added[0], [F[0], F[2]], rtol=1e-6)
    assert {round(value, 4) for value in added.ravel()} >= {round(value, 4) for value in F}, "every end was met"


def test_undefined_at_terminal_states_gives_the_same_f_in_single_environments():
    env = Single(Scripted(*EPISODES), one, GAMMA)
    added = []
    for episode in EPISODES:
        env.reset()
        added += [env.step(0)[4]["shaping_reward"] for _ in episode[1]]
    np.testing.assert_allclose(added, F, rtol=1e-6)


def test_a_partial_reset_does_not_evaluate_the_other_ended_environments():
    env = vector(AutoresetMode.DISABLED, one, EPISODES[1:2], EPISODES[1:2])
    np.testing.assert_allclose(play_without_resets(env), [F[2], F[2]], rtol=1e-6)
    _, infos = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(infos["potential"], [-1.0, 0.0])
    env.reset(options={"reset_mask": np.array([False, True])})
    np.testing.assert_allclose(play_without_resets(env), [F[2], F[2]], rtol=1e-6)


def play_without_resets(env):
    return env.step(np.zeros(env.num_envs, int))[4]["shaping_reward"]


@pytest.mark.parametrize("settings", [{"enabled": False}, {"scale": 0.5, "anneal_steps": 1}])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_potential_is_not_evaluated_while_shaping_is_off(mode, settings):
    asked = []

    def recording(obs):
        asked.append(obs[0])
        return obs[0]

    env = vector(mode, recording, **settings)
    before = len(asked)
    assert before == 0 or "anneal_steps" in settings
    added = play(env)
    assert len(asked) == before
    assert np.all(added[1:] == 0.0)
    env.enabled = True
    if "anneal_steps" not in settings:
        env.reset()
        assert np.all(play(env, 1) != 0.0)
        assert asked


def test_the_switch_evaluates_only_shaped_environments():
    """One environment continues its shaped episode; the other has started an unshaped one."""
    asked = []

    def recording(obs):
        asked.append(float(obs[0]))
        return obs[0]

    env = vector(AutoresetMode.SAME_STEP, recording)
    env.enabled = False
    env.step(np.zeros(2, int))  # the second ends and restarts at 4
    asked.clear()
    infos = env.step(np.zeros(2, int))[4]  # the first is truncated at 7
    assert asked == [7.0]
    np.testing.assert_allclose(infos["shaping_reward"], [F[1], 0.0], rtol=1e-6)
