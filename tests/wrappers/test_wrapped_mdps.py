"""Policy invariance, checked by exact planning: random finite MDPs as environments, shaped by the wrapper."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.mdps import greedy_sets, random_mdp, solve
from upslope import PotentialShaping

SCALES = st.sampled_from([0.1, 1.0, 10.0])


class FiniteEnv(gym.Env):
    """A finite MDP whose start state and next successor the test chooses."""

    def __init__(self, mdp):
        self.mdp = mdp
        states, actions = mdp.rewards.shape[:2]
        self.observation_space, self.action_space = gym.spaces.Discrete(states), gym.spaces.Discrete(actions)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state, self.following = options["state"], options["following"]
        return np.int64(self.state), {}

    def step(self, action):
        reward = self.mdp.rewards[self.state, action, self.following]
        self.state = self.following
        return np.int64(self.state), float(reward), bool(self.mdp.terminal[self.state]), False, {}


def shaped_rewards(env, mdp):
    """R + F of every possible transition, as the wrapper returns it."""
    rewards = np.zeros_like(mdp.rewards)
    for state in mdp.ordinary:
        for following in np.flatnonzero(mdp.chances[state].max(0) > 0):
            for action in range(rewards.shape[1]):
                env.reset(options={"state": int(state), "following": int(following)})
                rewards[state, action, following] = env.step(action)[1]
    return rewards


def invariant(seed, scale):
    """Whether the shaped MDP has the optimal policies of the raw one, and Q* lower by exactly Φ (Eq. 1)."""
    mdp = random_mdp(seed, states=6)
    table = scale * np.random.default_rng(seed).normal(size=6)
    shaped = shaped_rewards(PotentialShaping(FiniteEnv(mdp), lambda state: table[state], mdp.gamma), mdp)
    raw, optimum = solve(mdp), solve(mdp, shaped - mdp.rewards)
    assert np.any(np.abs(shaped - mdp.rewards)[mdp.ordinary] > 1e-3 * scale), "a silent no-op"
    np.testing.assert_allclose(
        optimum.q[mdp.ordinary], (raw.q - table[:, None])[mdp.ordinary], atol=1e-8 * scale + 1e-9
    )
    np.testing.assert_array_equal(greedy_sets(mdp, optimum.q, tolerance=1e-6), greedy_sets(mdp, raw.q, tolerance=1e-6))


@given(st.integers(0, 2**31 - 1), SCALES)
def test_policies_are_invariant(seed, scale):
    invariant(seed, scale)


@pytest.mark.slow
@settings(max_examples=1000)
@given(st.integers(0, 2**31 - 1), SCALES)
def test_policies_are_invariant_on_a_thousand(seed, scale):
    invariant(seed, scale)


def test_a_nonzero_terminal_potential_would_be_noticed():
    """The check has power: with Φ(terminal) kept, some policies change."""
    changed = 0
    for seed in range(20):
        mdp = random_mdp(seed, states=6)
        table = 5 * np.random.default_rng(seed).normal(size=6)
        kept = mdp.gamma * table[None, None, :] - table[:, None, None]
        changed += not np.array_equal(greedy_sets(mdp, solve(mdp, kept).q), greedy_sets(mdp, solve(mdp).q))
    assert changed >= 5
