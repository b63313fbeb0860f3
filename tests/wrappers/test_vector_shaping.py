"""The vector wrapper: three autoreset modes, Sync and Async, compared with the single wrapper; and bad input."""

from collections import Counter

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from support.scripted import EPISODES, GAMMA, RAW, F, Scripted, Walk, level
from upslope import PotentialShaping as Single
from upslope import UpslopeError
from upslope.wrappers.vector import PotentialShaping

#: A second script with the same episodes, shifted by one step.
SHIFTED = (EPISODES[1], EPISODES[2], EPISODES[0])
#: Terminated and truncated, in every combination.
ENDS = [(False, False), (False, True), (True, False), (True, True)]
NEXT, SAME, OFF = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED


def potential(obs):
    obs = np.asarray(obs, np.float64)
    return 3.0 * np.sin(obs[..., 0]) + obs[..., 1]


def scripts(mode, **settings):
    env = SyncVectorEnv([lambda: Scripted(*EPISODES), lambda: Scripted(*SHIFTED)], autoreset_mode=mode)
    env = PotentialShaping(env, level, GAMMA, **settings)
    env.reset(seed=0)
    return env


def play(env, steps):
    """F of every step ``[steps, n]``; with autoreset disabled, ended environments are reset by a mask."""
    added = []
    for _ in range(steps):
        _, _, terminated, truncated, infos = env.step(np.zeros(env.num_envs, int))
        added.append(infos["shaping_reward"])
        done = terminated | truncated
        if env.metadata["autoreset_mode"] is OFF and done.any():
            env.reset(options={"reset_mask": done})
    return np.array(added)


class TestModes:
    def test_dummy_steps_of_next_step_mode_have_zero_f(self):
        expected = [[F[0], F[2]], [F[1], 0.0], [0.0, F[3]], [F[2], 0.0], [0.0, F[0]], [F[3], F[1]]]
        np.testing.assert_allclose(play(scripts(NEXT), 6), expected, rtol=1e-6)

    @pytest.mark.parametrize("mode", [SAME, OFF])
    def test_every_step_is_a_transition_in_modes_without_dummy_steps(self, mode):
        expected = [[F[0], F[2]], [F[1], F[3]], [F[2], F[0]], [F[3], F[1]], [F[0], F[2]]]
        np.testing.assert_allclose(play(scripts(mode), 5), expected, rtol=1e-6)

    @pytest.mark.parametrize("mode", list(AutoresetMode))
    def test_a_full_reset_sets_every_potential(self, mode):
        env = scripts(mode)
        play(env, 1)
        env.reset()
        first_steps = {2.0: F[0], -1.0: F[2], 4.0: F[3]}
        expected = [first_steps[sub.start] for sub in env.unwrapped.envs]
        np.testing.assert_allclose(play(env, 1)[0], expected, rtol=1e-6)

    @pytest.mark.parametrize("mode", list(AutoresetMode))
    def test_info_reports_the_raw_reward_f_and_the_potential(self, mode):
        env = scripts(mode)
        _, rewards, _, _, infos = env.step(np.zeros(2, int))
        np.testing.assert_array_equal(infos["raw_reward"], [RAW[0], RAW[2]])
        np.testing.assert_allclose(rewards, [RAW[0] + F[0], RAW[2] + F[2]], rtol=1e-6)
        np.testing.assert_array_equal(infos["potential"], [5.0, 0.0])
        assert all(infos[f"_{key}"].all() for key in ("raw_reward", "shaping_reward", "potential"))

    def test_reset_reports_the_potential(self):
        env = PotentialShaping(SyncVectorEnv([lambda: Scripted(*EPISODES)] * 2), level, GAMMA)
        _, infos = env.reset()
        np.testing.assert_array_equal(infos["potential"], [2.0, 2.0])
        assert "raw_reward" not in infos


class TestSwitchAndAnnealing:
    @pytest.mark.parametrize("mode", list(AutoresetMode))
    def test_the_switch_takes_effect_at_each_environment_s_reset(self, mode):
        env = scripts(mode)
        env.enabled = False
        added = play(env, 4)
        np.testing.assert_allclose(added[:2], [[F[0], F[2]], [F[1], 0.0]], rtol=1e-6)
        np.testing.assert_array_equal(added[2:], 0.0)
        env.enabled = True
        assert np.any(play(env, 4) != 0.0)

    def test_annealing_weights_each_potential_by_its_own_time_step(self):
        added = play(scripts(SAME, anneal_steps=4), 2)
        np.testing.assert_allclose(added, [[0.75 * 0.9 * 5 - 2, 1.0], [0.5 * 0.9 * 7 - 0.75 * 5, -0.75 * 4]], rtol=1e-6)

    def test_scale_and_bias(self):
        added = play(scripts(SAME, scale=2.0, bias=10.0), 1)
        np.testing.assert_allclose(added, [[0.9 * 20 - 14, -8.0]], rtol=1e-6)


class TestInsideAndAround:
    @pytest.mark.parametrize("mode", list(AutoresetMode))
    def test_around_shaped_sub_environments_both_shaping_rewards_are_added(self, mode):
        env = SyncVectorEnv([lambda: Single(Scripted(*EPISODES), level, GAMMA)] * 2, autoreset_mode=mode)
        env = PotentialShaping(env, lambda obs: 2 * obs[0], GAMMA)
        env.reset(seed=0)
        seen = []
        for _ in range(2):
            _, rewards, _, _, infos = env.step(np.zeros(2, int))
            seen.append((rewards[0], infos["raw_reward"][0], infos["shaping_reward"][0], infos["potential"][0]))
        expected = [(RAW[i] + 3 * F[i], RAW[i], 3 * F[i], 3 * phi) for i, phi in ((0, 5.0), (1, 7.0))]
        np.testing.assert_allclose(seen, expected, rtol=1e-6)

    def test_around_another_vector_wrapper(self):
        env = PotentialShaping(scripts(SAME), lambda obs: 2 * obs[0], GAMMA)
        env.reset(seed=0)
        _, rewards, _, _, infos = env.step(np.zeros(2, int))
        starts = {2.0: 0, -1.0: 2, 4.0: 3}
        index = [starts[v] for v in (-1.0, 4.0)]
        np.testing.assert_allclose(infos["shaping_reward"], 3 * np.take(F, index), rtol=1e-6)
        np.testing.assert_allclose(infos["raw_reward"], np.take(RAW, index), rtol=1e-6)
        np.testing.assert_allclose(rewards, np.take(RAW, index) + 3 * np.take(F, index), rtol=1e-6)


def run_and_check(env, steps, seed):
    """Takes random actions and recomputes F from the observations alone; counts the transitions of each kind."""
    obs, _ = env.reset(seed=seed)
    mode, actions = env.metadata["autoreset_mode"], np.random.default_rng(seed)
    resetting = np.zeros(env.num_envs, bool)
    kinds = Counter()
    for _ in range(steps):
        following, rewards, terminated, truncated, infos = env.step(actions.integers(0, 2, env.num_envs))
        done = terminated | truncated
        for i in range(env.num_envs):
            successor = infos["final_obs"][i] if mode is SAME and done[i] else following[i]
            ahead = 0.0 if terminated[i] else env.gamma * potential(np.asarray(successor))
            expected = 0.0 if resetting[i] else ahead - potential(obs[i])
            assert abs(infos["shaping_reward"][i] - expected) < 1e-12
            assert abs(rewards[i] - infos["raw_reward"][i] - expected) < 1e-12
            kinds["dummy" if resetting[i] else (bool(terminated[i]), bool(truncated[i]))] += 1
        resetting = done if mode is NEXT else np.zeros_like(done)
        if mode is OFF and done.any():
            following, _ = env.reset(options={"reset_mask": done})
        obs = following
    return kinds


def sequences(mode, count, steps):
    """How many transitions of each kind agreed, over many random sequences of actions."""
    kinds = Counter()
    for seed in range(count):
        gamma = (0.5, 0.9, 1.0)[seed % 3]
        env = PotentialShaping(SyncVectorEnv([Walk] * 3, autoreset_mode=mode), potential, gamma)
        kinds += run_and_check(env, steps, seed)
    return kinds


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_random_sequences_against_a_plain_recomputation(mode):
    kinds = sequences(mode, count=20, steps=40)
    assert sum(kinds.values()) == 20 * 40 * 3
    assert min(kinds[ends] for ends in ENDS) > 10
    assert (kinds["dummy"] > 30) == (mode is NEXT)


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_thousands_of_random_sequences_against_a_plain_recomputation(mode):
    kinds = sequences(mode, count=2000, steps=40)
    assert sum(kinds.values()) == 2000 * 40 * 3
    assert min(kinds[ends] for ends in ENDS) > 3000
    assert (kinds["dummy"] > 3000) == (mode is NEXT)


@pytest.mark.parametrize(
    "mode", [SAME, *(pytest.param(mode, marks=pytest.mark.slow) for mode in AutoresetMode if mode != SAME)]
)
def test_worker_processes_give_the_same_rewards(mode, prior):
    """Async around (pickled) single wrappers, the vector wrapper around Async, and the vector wrapper around Sync."""

    def pole(inside):
        env = gym.make("CartPole-v1", max_episode_steps=9)
        return Single(env, prior.to_numpy(), 0.98) if inside else env

    spawned = {"autoreset_mode": mode, "context": "spawn"}
    envs = [
        AsyncVectorEnv([lambda: pole(True)] * 2, **spawned),
        PotentialShaping(AsyncVectorEnv([lambda: pole(False)] * 2, **spawned), prior, 0.98),
        PotentialShaping(SyncVectorEnv([lambda: pole(False)] * 2, autoreset_mode=mode), prior, 0.98),
    ]
    rewards_by_kind = []
    for env in envs:
        env.reset(seed=3)
        rewards = []
        for t in range(30):
            _, reward, terminated, truncated, _ = env.step(np.array([t % 2, 1]))
            rewards.append(reward)
            if mode is OFF and (terminated | truncated).any():
                env.reset(options={"reset_mask": terminated | truncated})
        env.close()
        rewards_by_kind.append(rewards)
    np.testing.assert_allclose(rewards_by_kind[0], rewards_by_kind[2], atol=1e-9)
    np.testing.assert_allclose(rewards_by_kind[1], rewards_by_kind[2], atol=1e-9)
    assert np.unique(np.round(rewards_by_kind[2], 6)).size > 20


class TestBadInput:
    def test_a_hidden_final_observation(self):
        class Hiding(SyncVectorEnv):
            def step(self, actions):
                *rest, infos = super().step(actions)
                infos.pop("final_obs", None)
                return (*rest, infos)

        env = PotentialShaping(Hiding([lambda: Scripted(*EPISODES)], autoreset_mode=SAME), level, GAMMA)
        env.reset(seed=0)
        env.step(np.zeros(1, int))
        with pytest.raises(UpslopeError, match="hides the final observation"):
            env.step(np.zeros(1, int))

    def test_an_unknown_autoreset_mode(self):
        env = SyncVectorEnv([Walk])
        env.metadata = {}
        with pytest.raises(UpslopeError, match="does not say how it resets"):
            PotentialShaping(env, level, GAMMA)

    def test_a_single_environment(self):
        with pytest.raises(UpslopeError, match=r"upslope\.shape"):
            PotentialShaping(Walk(), level, GAMMA)

    def test_a_gamma_that_differs_from_the_prior_s(self, prior):
        with pytest.raises(UpslopeError, match=r"gamma is 0\.9, but"):
            PotentialShaping(gym.make_vec("CartPole-v1", 2), prior, 0.9)

    def test_step_before_reset(self):
        with pytest.raises(UpslopeError, match="before reset"):
            PotentialShaping(SyncVectorEnv([Walk]), level, GAMMA).step(np.zeros(1, int))
