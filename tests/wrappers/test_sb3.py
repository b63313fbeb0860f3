"""Stable-Baselines3 as a client: its VecEnvs, its checks, and short runs of its learners."""

import os
import warnings

import gymnasium as gym
import numpy as np
import pytest

from support.scripted import EPISODES, GAMMA, RAW, F, Scripted, Walk, level
from upslope import PotentialShaping as Single
from upslope import UpslopeError

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor

    from upslope.wrappers.sb3 import PotentialShaping

SHIFTED = (EPISODES[1], EPISODES[2], EPISODES[0])


def venv(*scripts):
    return DummyVecEnv([lambda script=script: Scripted(*script) for script in scripts or (EPISODES, SHIFTED)])


def phi(obs):
    return 3.0 * np.sin(float(obs[0])) + float(obs[1])


class Dying(Walk):
    def step(self, action):
        os._exit(1)


class Growing(Walk):
    def step(self, action):
        obs, reward, *_, info = super().step(action)
        return np.append(obs, np.float32(0.0)), reward, False, False, info


class TestWrapper:
    def test_every_end(self):
        env = PotentialShaping(venv(), level, GAMMA)
        env.reset()
        rows = [env.step(np.zeros(2, int)) for _ in range(4)]
        added = [[info["shaping_reward"] for info in infos] for *_, infos in rows]
        np.testing.assert_allclose(added, [[F[0], F[2]], [F[1], F[3]], [F[2], F[0]], [F[3], F[1]]], rtol=1e-6)
        rewards = [row[1] for row in rows]
        expected = np.add([[RAW[0], RAW[2]], [RAW[1], RAW[3]], [RAW[2], RAW[0]], [RAW[3], RAW[1]]], added)
        np.testing.assert_allclose(rewards, expected, rtol=1e-6)
        assert rewards[0].dtype == np.float32
        assert [row[3][0]["raw_reward"] for row in rows] == list(RAW)
        assert [row[3][0]["potential"] for row in rows] == [5.0, 7.0, 0.0, 0.0]

    def test_random_walks_against_a_plain_recomputation(self):
        env = PotentialShaping(DummyVecEnv([Walk] * 3), phi, GAMMA)
        env.seed(0)
        obs = env.reset()
        for _ in range(300):
            following, _, dones, infos = env.step(np.zeros(3, int))
            for i, info in enumerate(infos):
                successor = info["terminal_observation"] if dones[i] else following[i]
                ahead = 0.0 if dones[i] and not info["TimeLimit.truncated"] else GAMMA * phi(successor)
                assert info["shaping_reward"] == pytest.approx(ahead - phi(obs[i]), abs=1e-12)
            obs = following

    def test_around_shaped_environments_both_shaping_rewards_are_added(self):
        env = PotentialShaping(DummyVecEnv([lambda: Single(Scripted(*EPISODES), level, GAMMA)]), level, GAMMA)
        env.reset()
        infos = [env.step(np.zeros(1, int))[3][0] for _ in range(4)]
        np.testing.assert_allclose([info["shaping_reward"] for info in infos], 2 * np.array(F), rtol=1e-6)
        assert [info["raw_reward"] for info in infos] == list(RAW)

    def test_switch_and_annealing(self):
        env = PotentialShaping(venv(EPISODES), level, GAMMA)
        env.reset()
        env.enabled = False
        added = [env.step(np.zeros(1, int))[3][0]["shaping_reward"] for _ in range(4)]
        np.testing.assert_allclose(added, [F[0], F[1], 0.0, 0.0], rtol=1e-6)
        env = PotentialShaping(venv(EPISODES), level, GAMMA, anneal_steps=4)
        env.reset()
        assert env.step(np.zeros(1, int))[3][0]["shaping_reward"] == pytest.approx(0.75 * 0.9 * 5 - 2)
        assert "Thm. 2.1" in PotentialShaping(venv(), level, GAMMA).invariance

    def test_the_monitor_inside_reports_raw_returns(self):
        env = PotentialShaping(VecMonitor(venv(EPISODES)), level, GAMMA)
        env.reset()
        env.step(np.zeros(1, int))
        assert env.step(np.zeros(1, int))[3][0]["episode"]["r"] == pytest.approx(RAW[0] + RAW[1])

    def test_it_exposes_its_discount(self):
        assert PotentialShaping(venv(), level, np.float32(0.5)).gamma == 0.5

    def test_the_potential_may_be_undefined_at_terminal_states(self):
        env = PotentialShaping(venv(), lambda obs: np.nan if obs[0] in (3.0, 6.0) else obs[0], GAMMA)
        env.reset()
        added = [[info["shaping_reward"] for info in env.step(np.zeros(2, int))[3]] for _ in range(4)]
        np.testing.assert_allclose(added, [[F[0], F[2]], [F[1], F[3]], [F[2], F[0]], [F[3], F[1]]], rtol=1e-6)

    def test_a_worker_that_dies(self):
        env = PotentialShaping(SubprocVecEnv([Dying, Walk], start_method="spawn"), level, GAMMA)
        env.reset()
        for _ in range(2):  # later calls raise the same error
            with pytest.raises(UpslopeError, match="worker process of the vector environment died"):
                env.step(np.zeros(2, int))
        assert not any(process.is_alive() for process in env.unwrapped.processes), "no process is left behind"
        env.close()

    def test_a_shape_that_changes(self):
        env = PotentialShaping(DummyVecEnv([Growing]), level, GAMMA)
        env.reset()
        with pytest.raises(UpslopeError, match="another shape than its observation space says"):
            env.step(np.zeros(1, int))

    def test_bad_input(self, prior):
        with pytest.raises(UpslopeError, match="not a VecEnv"):
            PotentialShaping(Walk(), level, GAMMA)
        with pytest.raises(UpslopeError, match="not a single Gymnasium environment"):
            Single(venv(), level, GAMMA)
        with pytest.raises(UpslopeError, match="but the environment's"):
            PotentialShaping(venv(), prior, 0.98)
        with pytest.raises(UpslopeError, match="before reset"):
            PotentialShaping(venv(), level, GAMMA).step(np.zeros(2, int))

    def test_a_hidden_terminal_observation(self):
        class Hiding(DummyVecEnv):
            def step_wait(self):
                obs, rewards, dones, infos = super().step_wait()
                return obs, rewards, dones, [{"TimeLimit.truncated": True} for _ in infos]

        env = PotentialShaping(Hiding([lambda: Scripted(*EPISODES)]), level, GAMMA)
        env.reset()
        env.step(np.zeros(1, int))
        with pytest.raises(UpslopeError, match="hides the final observation"):
            env.step(np.zeros(1, int))


class TestClients:
    @pytest.mark.parametrize("name", ["upslope/CartPole-v0", "upslope/ContinuousCartPole-v0"])
    def test_the_checker_of_stable_baselines3_passes(self, name, prior):
        check_env(Single(gym.make(name), prior, 0.98))

    @pytest.mark.parametrize(
        "algorithm", ["DQN", *(pytest.param(name, marks=pytest.mark.slow) for name in ("PPO", "SAC", "TD3", "DDPG"))]
    )
    def test_learners_run_on_shaped_rewards_and_report_raw_returns(self, algorithm, prior):
        name = "upslope/CartPole-v0" if algorithm in ("DQN", "PPO") else "upslope/ContinuousCartPole-v0"
        env = Single(Monitor(gym.make(name, length=3.0)), prior, 0.98)
        settings = {"n_steps": 64} if algorithm == "PPO" else {"learning_starts": 50}
        settings["policy_kwargs"] = {"net_arch": [16]}
        model = getattr(sb3, algorithm)("MlpPolicy", env, gamma=0.98, device="cpu", seed=0, **settings)
        model.learn(80)
        lengths, returns = zip(*[(info["l"], info["r"]) for info in model.ep_info_buffer], strict=True)
        assert lengths == returns, "raw: one per step"
        mean, _ = evaluate_policy(model, env, n_eval_episodes=2, warn=False)
        assert mean == int(mean * 2) / 2

    def test_worker_processes(self, prior):
        def pole():
            return Single(gym.make("upslope/CartPole-v0"), prior.to_numpy(), 0.98)

        rows = []
        for kind, settings in ((DummyVecEnv, {}), (SubprocVecEnv, {"start_method": "spawn"})):
            env = kind([pole] * 2, **settings)
            env.seed(0)
            env.reset()
            rows.append([env.step(np.array([0, 1]))[1] for _ in range(5)])
            env.close()
        np.testing.assert_allclose(rows[0], rows[1], atol=1e-6)
