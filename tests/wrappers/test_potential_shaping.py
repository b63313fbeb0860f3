"""The single wrapper: ends of episodes, contents of info, the switch, annealing, copies, and bad input."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import Autoreset, RecordEpisodeStatistics, TimeLimit
from hypothesis import given, settings
from hypothesis import strategies as st

from support.scripted import EPISODES, GAMMA, RAW, F, Scripted, Step, Walk, level
from upslope import PotentialShaping, UpslopeError


def shaped(*episodes, **settings):
    env = PotentialShaping(Scripted(*(episodes or EPISODES)), level, GAMMA, **settings)
    env.reset(seed=0)
    return env


def play(env, steps=4):
    """Reward and info of every step, with a reset after every end."""
    transitions = []
    for _ in range(steps):
        _, reward, terminated, truncated, info = env.step(0)
        transitions.append((reward, info))
        if terminated or truncated:
            env.reset()
    return transitions


class TestEnds:
    def test_ordinary_truncated_terminated_and_both_at_once(self):
        transitions = play(shaped())
        np.testing.assert_allclose([info["shaping_reward"] for _, info in transitions], F, rtol=1e-6)
        np.testing.assert_allclose([reward for reward, _ in transitions], np.add(RAW, F), rtol=1e-6)
        assert [info["raw_reward"] for _, info in transitions] == list(RAW)

    def test_potential_is_zero_where_an_episode_terminated_and_kept_where_it_was_truncated(self):
        assert [info["potential"] for _, info in play(shaped())] == [5.0, 7.0, 0.0, 0.0]

    def test_time_limit_is_a_truncation(self):
        env = PotentialShaping(TimeLimit(Scripted((2.0, [Step(5.0), Step(6.0)])), 1), level, GAMMA)
        env.reset(seed=0)
        _, reward, terminated, truncated, _ = env.step(0)
        assert (terminated, truncated) == (False, True)
        assert reward == pytest.approx(1 + 0.9 * 5 - 2)

    def test_a_dummy_step_of_an_inner_autoreset_has_zero_f_and_sets_the_potential(self):
        env = PotentialShaping(Autoreset(Scripted(*EPISODES)), level, GAMMA)
        env.reset(seed=0)
        transitions = [env.step(0) for _ in range(6)]
        added = [info["shaping_reward"] for *_, info in transitions]
        np.testing.assert_allclose(added, [F[0], F[1], 0.0, F[2], 0.0, F[3]], rtol=1e-6)
        assert transitions[2][4]["potential"] == -1.0

    def test_a_reset_in_mid_episode_discards_the_old_potential(self):
        env = shaped()
        env.step(0)
        env.reset()
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(F[2])


class TestOutputs:
    def test_plain_floats_and_bools(self):
        env = shaped()
        obs, reward, terminated, truncated, info = env.step(0)
        assert type(reward) is float
        assert type(terminated) is type(truncated) is bool
        assert {type(info[key]) for key in ("raw_reward", "shaping_reward", "potential")} == {float}
        assert obs.dtype == np.float32
        assert info["seen"] == 1

    def test_reset_reports_the_potential(self):
        assert PotentialShaping(Scripted(*EPISODES), level, GAMMA).reset()[1]["potential"] == 2.0

    def test_a_monitor_inside_reports_raw_returns(self):
        env = PotentialShaping(RecordEpisodeStatistics(Scripted(*EPISODES)), level, GAMMA)
        env.reset(seed=0)
        env.step(0)
        assert env.step(0)[4]["episode"]["r"] == pytest.approx(RAW[0] + RAW[1])

    def test_nested_wrappers_add_both_shaping_rewards(self):
        env = PotentialShaping(shaped(), lambda obs: 2 * obs[0] + 1, GAMMA)
        env.reset(seed=0)
        env.env.env.at = 0
        env.reset(seed=0)
        _, reward, _, _, info = env.step(0)
        both = (1 + 2) * np.array([-1.0, 3.0]) + 1  # Φ1 + Φ2 at −1 and 3
        assert info["raw_reward"] == RAW[2]
        assert info["shaping_reward"] == pytest.approx(-both[0])
        assert reward == pytest.approx(RAW[2] - both[0])
        assert info["potential"] == 0.0

    def test_info_keys_of_the_environment_are_not_taken_for_shaping(self):
        class WithInfo(Scripted):
            def step(self, action):
                return (*super().step(action)[:4], {"potential": "a word", "raw_reward": "another"})

        env = PotentialShaping(WithInfo(*EPISODES), level, GAMMA)
        env.reset(seed=0)
        info = env.step(0)[4]
        assert (info["potential"], info["raw_reward"]) == (5.0, 0.5)


class TestScaleBiasSwitchAnnealing:
    def test_scale_and_bias(self):
        transitions = play(shaped(scale=2.0, bias=10.0))
        potentials = np.array([[14.0, 20.0], [20.0, 24.0], [8.0, 0.0], [18.0, 0.0]])
        np.testing.assert_allclose(
            [info["shaping_reward"] for _, info in transitions], potentials @ [-1.0, GAMMA], rtol=1e-6
        )

    def test_the_switch_takes_effect_at_the_next_reset(self):
        env = shaped()
        env.enabled = False
        transitions = play(env)
        np.testing.assert_allclose(
            [info["shaping_reward"] for _, info in transitions], [F[0], F[1], 0.0, 0.0], rtol=1e-6
        )
        assert [reward for reward, _ in transitions[2:]] == list(RAW[2:])
        env.enabled = True
        env.reset()
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(F[2])

    def test_when_off_from_the_start_rewards_are_raw_and_the_potential_is_not_evaluated(self):
        env = PotentialShaping(Scripted(*EPISODES), lambda obs: 1 / 0, GAMMA, enabled=False)
        env.reset(seed=0)
        assert [reward for reward, _ in play(env)] == list(RAW)

    def test_annealing_weights_each_potential_by_its_own_time_step(self):
        env = shaped((2.0, [Step(5.0), Step(7.0), Step(9.0, truncated=True)]), anneal_steps=2)
        added = [info["shaping_reward"] for _, info in play(env, 3)]
        np.testing.assert_allclose(added, [0.9 * 0.5 * 5 - 1.0 * 2, 0.0 - 0.5 * 5, 0.0], rtol=1e-6)

    def test_an_annealed_episode_telescopes(self):
        env = shaped((2.0, [Step(v) for v in (5.0, -3.0, 7.0)] + [Step(9.0, terminated=True)]), anneal_steps=10)
        added = [info["shaping_reward"] for _, info in play(env, 4)]
        assert np.sum(GAMMA ** np.arange(4) * added) == pytest.approx(-2.0)

    def test_each_documents_whether_it_is_policy_invariant(self):
        assert "Thm. 2.1" in shaped().invariance
        assert "not policy-invariant" in shaped(anneal_steps=5).invariance


class TestCopies:
    def test_copies_continue_from_the_same_state(self):
        env = shaped()
        env.step(0)
        for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
            assert twin.step(0)[4]["shaping_reward"] == pytest.approx(F[1])


class TestBadInput:
    @pytest.mark.parametrize("gamma", [0.0, -0.5, 1.01, float("nan")])
    def test_invalid_discounts(self, gamma):
        with pytest.raises(UpslopeError, match="gamma is"):
            PotentialShaping(Scripted(*EPISODES), level, gamma)

    def test_gamma_is_required(self):
        with pytest.raises(TypeError, match="gamma"):
            PotentialShaping(Scripted(*EPISODES), level)

    def test_a_gamma_that_differs_from_the_prior_s(self, prior):
        with pytest.raises(UpslopeError, match=r"gamma is 0.99, but the prior was learned with 0.98"):
            PotentialShaping(gym.make("CartPole-v1"), prior, 0.99)

    @pytest.mark.parametrize("settings", [{"scale": float("inf")}, {"bias": float("nan")}, {"anneal_steps": 0}])
    def test_invalid_settings(self, settings):
        with pytest.raises(UpslopeError, match=next(iter(settings))):
            shaped(**settings)

    def test_a_vector_environment(self):
        envs = gym.vector.SyncVectorEnv([lambda: Scripted(*EPISODES)])
        with pytest.raises(UpslopeError, match=r"upslope\.shape"):
            PotentialShaping(envs, level, GAMMA)

    def test_step_before_reset(self):
        with pytest.raises(UpslopeError, match="before reset"):
            PotentialShaping(Scripted(*EPISODES), level, GAMMA).step(0)

    def test_step_after_an_end(self):
        env = shaped()
        env.step(0)
        env.step(0)
        with pytest.raises(UpslopeError, match="after the episode had ended"):
            env.step(0)

    def test_an_observation_that_changes_its_shape(self):
        class Growing(Scripted):
            def step(self, action):
                obs, *rest = super().step(action)
                return (np.append(obs, 0.0), *rest)

        env = PotentialShaping(Growing(*EPISODES), level, GAMMA)
        env.reset(seed=0)
        with pytest.raises(UpslopeError, match=r"shape \(3,\), but its observation space says \(2,\)"):
            env.step(0)


def walk(seed, gamma, actions):
    """Runs a random walk and recomputes F of every step from the observations alone."""

    def potential(obs):
        return 3.0 * np.sin(float(obs[0])) + float(obs[1])

    env = PotentialShaping(Walk(), potential, gamma)
    obs, _ = env.reset(seed=seed)
    for action in actions:
        following, reward, terminated, truncated, info = env.step(action)
        expected = (0.0 if terminated else gamma * potential(following)) - potential(obs)
        assert info["shaping_reward"] == pytest.approx(expected, abs=1e-12)
        assert reward == pytest.approx(info["raw_reward"] + expected, abs=1e-12)
        obs = env.reset()[0] if terminated or truncated else following


SEEDS, GAMMAS = st.integers(0, 2**31 - 1), st.sampled_from([0.5, 0.9, 1.0])
ACTIONS = st.lists(st.integers(0, 1), min_size=60, max_size=60)


@given(SEEDS, GAMMAS, ACTIONS)
def test_random_walks_against_a_plain_recomputation(seed, gamma, actions):
    walk(seed, gamma, actions)


@pytest.mark.slow
@settings(max_examples=2000)
@given(SEEDS, GAMMAS, ACTIONS)
def test_thousands_of_random_walks_against_a_plain_recomputation(seed, gamma, actions):
    walk(seed, gamma, actions)
