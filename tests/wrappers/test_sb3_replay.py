"""Shaping of sampled batches: the replay buffer for Stable-Baselines3, for potentials that change."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from support.scripted import GAMMA, Walk
from upslope import UpslopeError

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from upslope.wrappers.sb3 import ShapedReplayBuffer


def phi(obs):
    return 3.0 * np.sin(float(obs[0])) + float(obs[1])


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

    def test_raw_rewards_are_stored_and_f_is_added_when_a_batch_is_sampled(self):
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

    def test_a_changing_potential_shapes_a_whole_batch_with_one_version(self):
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

    def test_every_batch_contains_the_discount_of_f(self):
        batch = self.filled(gamma=0.5)._get_samples(np.arange(150))
        assert batch.discounts.shape == batch.rewards.shape
        assert np.all(batch.discounts.numpy() == 0.5)

    def test_a_learner_bootstraps_with_the_discount_of_f(self):
        def train(own, buffer_s):
            model = sb3.DQN(
                "MlpPolicy", Walk(), gamma=own, learning_starts=20, replay_buffer_class=ShapedReplayBuffer,
                replay_buffer_kwargs={"potential": phi, "gamma": buffer_s}, policy_kwargs={"net_arch": [8]},
                device="cpu", seed=0,
            )  # fmt: skip
            model.learn(60)
            return model.q_net.q_net[0].weight.detach().numpy()

        np.testing.assert_array_equal(train(0.99, 0.5), train(0.5, 0.5))
        assert np.any(train(0.9, 0.9) != train(0.5, 0.5))

    def test_n_step_returns_are_refused(self):
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
        with pytest.raises(UpslopeError, match="is not a potential"):
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
