"""Learning from a shaped environment: n-step returns, repeated actions, Q-learning."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from support.scripted import Walk
from upslope import PotentialShaping, check_shaping
from upslope.wrappers.vector import PotentialShaping as VectorShaping

GAMMA = 0.9


def phi(obs):
    return 3.0 * np.sin(float(obs[0])) + float(obs[1])


class Endless(Walk):
    """A walk without an end."""

    def step(self, action):
        obs, reward, *_ = super().step(action)
        return obs, reward, False, False, {}


class Repeat(gym.Wrapper):
    """Repeats each action k times and returns the discounted sum of rewards, for a learner that discounts by γ^k."""

    def __init__(self, env, count):
        super().__init__(env)
        self.count = count

    def step(self, action):
        total = 0.0
        for index in range(self.count):
            obs, reward, terminated, truncated, info = self.env.step(action)
            total += GAMMA**index * reward
            if terminated or truncated:
                break
        return obs, total, terminated, truncated, info


@pytest.mark.parametrize("steps", [1, 3, 7])
def test_n_step_returns_telescope(steps):
    env = PotentialShaping(Endless(), phi, GAMMA)
    start, _ = env.reset(seed=0)
    added = 0.0
    for index in range(steps):
        obs, *_, info = env.step(index % 2)
        added += GAMMA**index * info["shaping_reward"]
    assert added == pytest.approx(GAMMA**steps * phi(obs) - phi(start), abs=1e-12)


def test_repeated_actions_need_the_discount_to_the_power_of_the_repeat():
    inside = Repeat(PotentialShaping(Endless(), phi, GAMMA), 4)
    outside = PotentialShaping(Repeat(Endless(), 4), phi, GAMMA**4)
    for env in (inside, outside):
        env.reset(seed=1)
    for action in (0, 1, 1, 0, 1):
        rewards = [env.step(action)[1] for env in (inside, outside)]
        assert rewards[0] == pytest.approx(rewards[1], abs=1e-12)
    wrong = check_shaping(PotentialShaping(Repeat(Walk(), 2), phi, GAMMA), phi, GAMMA**2, steps=400)
    assert "gamma_mismatch" in [finding.name for finding in wrong.findings]


class Ring(gym.Env):
    """Seven places in a ring, with a goal; the environment's own generator draws the slips."""

    observation_space = gym.spaces.Discrete(7)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.time = int(self.np_random.integers(1, 7)), 0
        return self.place, {}

    def step(self, action):
        self.time += 1
        move = (1 if action else -1) * (-1 if self.np_random.random() < 0.2 else 1)
        self.place = (self.place + move) % 7
        return self.place, float(self.place == 0), self.place == 0, self.time == 12, {}


TABLE = np.random.default_rng(5).normal(size=7)


def train(env, start, steps, mode=None):
    """Actions and Q-table of ε-greedy Q-learning in a single environment or a vector of one."""
    rng, q, taken = np.random.default_rng(0), np.repeat(start[:, None], 2, axis=1), []
    state = int(np.ravel(env.reset(seed=7)[0])[0])
    resetting = False
    for _ in range(steps):
        action = int(rng.integers(2)) if rng.random() < 0.3 else int(np.argmax(q[state]))
        following, reward, terminated, truncated, infos = env.step(action if mode is None else np.array([action]))
        following, reward, terminated, truncated = (np.ravel(x)[0] for x in (following, reward, terminated, truncated))
        done = bool(terminated or truncated)
        if not resetting:
            taken.append(action)
            final = int(infos["final_obs"][0]) if done and mode is AutoresetMode.SAME_STEP else int(following)
            q[state, action] += 0.2 * (reward + GAMMA * (not terminated) * q[final].max() - q[state, action])
        resetting = done and mode is AutoresetMode.NEXT_STEP
        state = int(following)
        if done and mode is None:
            state = env.reset()[0]
        elif done and mode is AutoresetMode.DISABLED:
            state = int(env.reset(options={"reset_mask": np.array([True])})[0][0])
    return taken, q


@pytest.mark.parametrize("mode", [None, *AutoresetMode])
def test_shaped_q_learning_acts_like_unshaped_q_learning_initialised_with_the_potential(mode):
    """Wiewiora's equivalence through the wrappers, terminations and truncations included, in each autoreset mode."""

    def make(shaped):
        if mode is None:
            return PotentialShaping(Ring(), lambda place: TABLE[place], GAMMA) if shaped else Ring()
        envs = SyncVectorEnv([Ring], autoreset_mode=mode)
        return VectorShaping(envs, lambda place: TABLE[place], GAMMA) if shaped else envs

    shaped, shaped_q = train(make(True), np.zeros(7), 3000, mode)
    unshaped, unshaped_q = train(make(False), TABLE, 3000, mode)
    assert shaped == unshaped
    np.testing.assert_allclose(shaped_q[1:] + TABLE[1:, None], unshaped_q[1:], atol=1e-12)
    assert np.abs(shaped_q[1:]).min() > 1e-3, "something must have been learned everywhere"
