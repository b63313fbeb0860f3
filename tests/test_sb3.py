"""Stable-Baselines3 as a client: its VecEnvs, its replay buffer, its checks, and short runs of its learners."""

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
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor, VecNormalize

    from upslope.wrappers.sb3 import PotentialShaping, ShapedReplayBuffer

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
        obs, *rest = super().step(action)
        return (np.append(obs, np.float32(0.0)), *rest)


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

    def test_around_shaped_environments_both_add_up(self):
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

    def test_it_tells_its_discount(self):
        assert PotentialShaping(venv(), level, np.float32(0.5)).gamma == 0.5

    def test_the_potential_may_be_undefined_at_terminal_states(self):
        env = PotentialShaping(venv(), lambda obs: np.nan if obs[0] in (3.0, 6.0) else obs[0], GAMMA)
        env.reset()
        added = [[info["shaping_reward"] for info in env.step(np.zeros(2, int))[3]] for _ in range(4)]
        np.testing.assert_allclose(added, [[F[0], F[2]], [F[1], F[3]], [F[2], F[0]], [F[3], F[1]]], rtol=1e-6)

    def test_a_worker_that_dies(self):
        env = PotentialShaping(SubprocVecEnv([Dying, Walk], start_method="spawn"), level, GAMMA)
        env.reset()
        for _ in range(2):  # and again, when it is known
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
        with pytest.raises(UpslopeError, match="no VecEnv"):
            PotentialShaping(Walk(), level, GAMMA)
        with pytest.raises(UpslopeError, match="no single Gymnasium environment"):
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


class TestReplay:
    def buffer(self, **settings):
        space = Walk.observation_space
        return ShapedReplayBuffer(
            200, space, Walk.action_space, device="cpu", **{"potential": phi, "gamma": GAMMA} | settings
        )

    def filled(self, **settings):
        buffer, env = self.buffer(**settings), DummyVecEnv([Walk])
        env.seed(1)
        obs = env.reset()
        for _ in range(150):
            following, rewards, dones, infos = env.step(np.zeros(1, int))
            true = np.where(dones[:, None], [infos[0].get("terminal_observation", following[0])], following)
            buffer.add(obs, true, np.zeros(1, int), rewards, dones, infos)
            obs = following
        return buffer

    def test_raw_rewards_are_stored_and_f_is_added_when_a_batch_is_drawn(self):
        buffer = self.filled()
        batch = buffer._get_samples(np.arange(150))
        terminated = batch.dones.numpy()[:, 0]
        assert 0 < terminated.sum() < buffer.dones.sum(), "some truncated, some terminated"
        expected = [
            raw + GAMMA * (1 - end) * phi(ahead) - phi(obs)
            for raw, end, obs, ahead in zip(
                buffer.rewards[:150, 0],
                terminated,
                batch.observations.numpy(),
                batch.next_observations.numpy(),
                strict=True,
            )
        ]
        np.testing.assert_allclose(batch.rewards.numpy()[:, 0], expected, rtol=1e-5, atol=1e-5)

    def test_a_potential_that_moves_shapes_all_of_a_batch_with_one_version(self):
        buffer = self.filled()
        first = buffer._get_samples(np.arange(150)).rewards.numpy()[:, 0]
        buffer.potential = lambda obs: 2.0 * phi(obs)
        second = buffer._get_samples(np.arange(150)).rewards.numpy()[:, 0]
        raw = buffer.rewards[:150, 0]
        np.testing.assert_allclose(second - raw, 2 * (first - raw), rtol=1e-4, atol=1e-4)
        assert np.abs(first - raw).max() > 1

    def test_the_potential_may_be_undefined_at_terminal_states(self):
        buffer = self.filled()
        expected = buffer._get_samples(np.arange(150))
        ends = {tuple(obs) for obs, end in zip(expected.next_observations, expected.dones, strict=True) if end}
        ends = {tuple(float(part) for part in obs) for obs in ends}
        assert len(ends) > 5
        buffer.potential = lambda obs: np.nan if tuple(obs.tolist()) in ends else phi(obs)
        np.testing.assert_array_equal(buffer._get_samples(np.arange(150)).rewards, expected.rewards)

    def test_discrete_observations(self):
        table, space = np.array([1.0, 5.0, 2.0]), gym.spaces.Discrete(3)
        buffer = ShapedReplayBuffer(4, space, space, device="cpu", potential=lambda obs: table[obs], gamma=GAMMA)
        buffer.add(np.array([0]), np.array([1]), np.array([0]), np.array([7.0]), np.array([False]), [{}])
        assert buffer.sample(1).rewards.item() == pytest.approx(7 + GAMMA * 5 - 1)

    def test_every_batch_brings_the_discount_of_f(self):
        batch = self.filled(gamma=0.5)._get_samples(np.arange(150))
        assert batch.discounts.shape == batch.rewards.shape
        assert np.all(batch.discounts.numpy() == 0.5)

    def test_a_learner_bootstraps_with_the_discount_of_f(self):
        def learned(own, buffer_s):
            model = sb3.DQN(
                "MlpPolicy", Walk(), gamma=own, learning_starts=20, replay_buffer_class=ShapedReplayBuffer,
                replay_buffer_kwargs={"potential": phi, "gamma": buffer_s}, policy_kwargs={"net_arch": [8]},
                device="cpu", seed=0,
            )  # fmt: skip
            model.learn(60)
            return model.q_net.q_net[0].weight.detach().numpy()

        np.testing.assert_array_equal(learned(0.99, 0.5), learned(0.5, 0.5))
        assert np.any(learned(0.9, 0.9) != learned(0.5, 0.5))

    def test_returns_of_many_steps_are_refused(self):
        with pytest.raises(UpslopeError, match="n_steps is 3, but ShapedReplayBuffer gives returns of one step"):
            self.buffer(n_steps=3)

    def test_repeated_actions(self, prior):
        space = gym.make("CartPole-v1").observation_space
        settings = {"device": "cpu", "potential": prior, "gamma": 0.98**4}
        assert ShapedReplayBuffer(9, space, Walk.action_space, repeat=4, **settings).potential.gamma == 0.98
        with pytest.raises(UpslopeError, match="set repeat"):
            ShapedReplayBuffer(9, space, Walk.action_space, **settings)

    def test_bad_input(self, prior):
        with pytest.raises(UpslopeError, match="gamma is"):
            self.buffer(gamma=1.5)
        with pytest.raises(UpslopeError, match="is no potential"):
            self.buffer(potential=3.0)
        normalised = VecNormalize(DummyVecEnv([Walk]))
        with pytest.raises(UpslopeError, match="VecNormalize"):
            self.filled().sample(4, env=normalised)

    def test_dqn_learns_with_it(self, prior):
        env = Monitor(gym.make("upslope/CartPole-v0", length=2.0))
        settings = {"potential": prior, "gamma": 0.98}
        model = sb3.DQN(
            "MlpPolicy", env, gamma=0.98, learning_starts=50, replay_buffer_class=ShapedReplayBuffer,
            replay_buffer_kwargs=settings, device="cpu", seed=0,
        )  # fmt: skip
        model.learn(200)
        assert np.all(model.replay_buffer.rewards[:200] == 1.0), "raw rewards are stored"
        assert np.all(model.replay_buffer.sample(50).rewards.numpy() != 1.0)


class TestClients:
    @pytest.mark.parametrize("name", ["upslope/CartPole-v0", "upslope/ContinuousCartPole-v0"])
    def test_its_own_checker_passes(self, name, prior):
        check_env(Single(gym.make(name), prior, 0.98))

    @pytest.mark.parametrize("algorithm", ["DQN", "PPO", "SAC", "TD3", "DDPG"])
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
