"""Thms. 2.1 and 3.1 and Wiewiora's equivalence, on random finite MDPs solved exactly."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.mdps import FiniteMDP, greedy_sets, random_mdp, solve
from upslope.equations.shaping import shaped_optimum
from upslope.learners.shaping import not_policy_invariant, potential_based
from upslope.types import Transition

seeds = st.integers(0, 2**32 - 1)
gammas = st.floats(0.5, 0.97)


@partial(jax.jit, static_argnames="terminal_gamma")
def _f(potential, discount, terminal_gamma):
    """F(s, s') ``[states, states]`` by upslope's shaping; the observation of a state is its index."""
    states = len(potential)
    obs, next_obs = jnp.divmod(jnp.arange(states**2), states)
    batch = Transition(
        obs[:, None].astype(float), jnp.zeros(states**2, int), jnp.zeros(states**2), discount[next_obs],
        next_obs[:, None].astype(float),
    )  # fmt: skip

    def table(obs):
        return potential[obs[0].astype(int)]

    shaping = potential_based(table) if terminal_gamma is None else not_policy_invariant(table, terminal_gamma)
    return shaping.rewards(batch).reshape(states, states)


def shaping_rewards(mdp: FiniteMDP, potential: np.ndarray, *, gamma=None, terminal_gamma=None) -> np.ndarray:
    """F(s, a, s') ``[states, 1, states]``, by the MDP's γ unless another is given."""
    discount = mdp.discount if gamma is None else gamma * (1.0 - mdp.terminal)
    with jax.enable_x64(True):
        added = _f(jnp.asarray(potential), jnp.asarray(discount), terminal_gamma)
        return np.asarray(added)[:, None]


def random_potential(seed: int, mdp: FiniteMDP, scale: float = 1.0) -> np.ndarray:
    return scale * np.random.default_rng(seed + 1).normal(size=len(mdp.terminal))


def changes_the_policy(mdp: FiniteMDP, added: np.ndarray) -> bool:
    return not np.array_equal(greedy_sets(mdp, solve(mdp).q), greedy_sets(mdp, solve(mdp, added).q))


def check_policy_invariance(seed, gamma, scale):
    mdp = random_mdp(seed, gamma=gamma)
    potential = random_potential(seed, mdp, scale)
    plain, shaped = solve(mdp), solve(mdp, shaping_rewards(mdp, potential))
    with jax.enable_x64(True):
        expected_q = np.asarray(shaped_optimum(jnp.asarray(plain.q), jnp.asarray(potential)[:, None]))
        expected_v = np.asarray(shaped_optimum(jnp.asarray(plain.v), jnp.asarray(potential)))
    np.testing.assert_allclose(shaped.q, expected_q, atol=1e-10)
    np.testing.assert_allclose(shaped.v[mdp.ordinary], expected_v[mdp.ordinary], atol=1e-10)
    np.testing.assert_array_equal(greedy_sets(mdp, shaped.q), greedy_sets(mdp, plain.q))


class TestTheorem21:
    @given(seeds, gammas, st.sampled_from([0.1, 1.0, 10.0]))
    def test_shaping_subtracts_the_potential_and_keeps_every_optimal_action(self, seed, gamma, scale):
        check_policy_invariance(seed, gamma, scale)

    @pytest.mark.slow
    def test_a_thousand_times(self):
        for seed in range(1000):
            check_policy_invariance(seed, (0.5, 0.8, 0.95, 0.97)[seed % 4], (0.1, 1.0, 10.0)[seed % 3])

    def test_some_states_have_several_optimal_actions(self):
        # Otherwise the tests above would only compare single greedy actions.
        mdp = random_mdp(0)
        assert (greedy_sets(mdp, solve(mdp).q).sum(-1) > 1).any()

    @pytest.mark.parametrize(
        "wrong",
        [
            pytest.param({"terminal_gamma": 0.95}, id="terminal potential kept"),
            pytest.param({"gamma": 0.99}, id="another gamma"),
            pytest.param({"gamma": 1.0, "terminal_gamma": 1.0}, id="no gamma and terminal potential kept"),
        ],
    )
    def test_other_shapings_change_some_policies(self, wrong):
        changed = 0
        for seed in range(20):
            mdp = random_mdp(seed)
            potential = random_potential(seed, mdp, scale=10.0)
            changed += changes_the_policy(mdp, shaping_rewards(mdp, potential, **wrong))
            assert not changes_the_policy(mdp, shaping_rewards(mdp, potential))
        assert changed >= 2

    def test_arbitrary_added_rewards_change_some_policies(self):
        mdps = [random_mdp(seed) for seed in range(20)]
        noise = np.random.default_rng(0).normal(size=(20, *mdps[0].rewards.shape))
        assert sum(changes_the_policy(mdp, added) for mdp, added in zip(mdps, noise, strict=True)) >= 2


class QLearner:
    """Tabular ε-greedy Q-learning; the caller supplies the random numbers."""

    def __init__(self, q: np.ndarray, mdp: FiniteMDP, added: np.ndarray):
        self.q, self.mdp, self.rewards, self.state, self.actions = q, mdp, mdp.rewards + added, 0, []

    def step(self, explore: bool, anything: int, lot: float, restart: int) -> None:
        state, mdp = self.state, self.mdp
        action = anything if explore else int(np.argmax(self.q[state]))
        following = min(int(np.searchsorted(np.cumsum(mdp.chances[state, action]), lot)), len(mdp.terminal) - 1)
        target = self.rewards[state, action, following] + mdp.discount[following] * self.q[following].max()
        self.q[state, action] += 0.2 * (target - self.q[state, action])
        self.actions.append(action)
        self.state = restart if mdp.terminal[following] else following


def check_wiewiora(seed, steps):
    mdp = random_mdp(seed)
    potential = random_potential(seed, mdp)
    start = np.zeros(mdp.chances.shape[:2])
    shaped = QLearner(start.copy(), mdp, shaping_rewards(mdp, potential))
    unshaped = QLearner(start + potential[:, None], mdp, np.zeros(()))
    rng = np.random.default_rng(seed)
    for explore, anything, lot, restart in zip(
        rng.random(steps) < 0.3, rng.integers(3, size=steps), rng.random(steps), rng.choice(mdp.ordinary, steps),
        strict=True,
    ):  # fmt: skip
        for learner in (shaped, unshaped):
            learner.step(explore, anything, lot, restart)
    assert shaped.actions == unshaped.actions
    assert np.abs(shaped.q).max() > 0.1, "something must have been learned"
    np.testing.assert_allclose(
        (shaped.q + potential[:, None])[mdp.ordinary], unshaped.q[mdp.ordinary], rtol=0, atol=1e-10
    )


class TestWiewiorasEquivalence:
    """Q-learning shaped by Φ from Q = 0, and unshaped from Q = Φ, take the same actions at every step."""

    @given(seeds)
    def test_shaped_and_initialised_learners_take_the_same_actions(self, seed):
        check_wiewiora(seed, steps=1000)

    @pytest.mark.slow
    def test_over_200_000_steps(self):
        check_wiewiora(0, steps=200_000)


def check_optimal_credit_assignment(seed, gamma):
    mdp = random_mdp(seed, gamma=gamma)
    optimum = solve(mdp)
    rewards = mdp.rewards + shaping_rewards(mdp, optimum.v)
    expected = np.sum(mdp.chances * rewards, axis=-1)[mdp.ordinary]
    advantage = (optimum.q - optimum.v[:, None])[mdp.ordinary]
    np.testing.assert_allclose(expected, advantage, atol=1e-10)
    optimal = greedy_sets(mdp, optimum.q)
    np.testing.assert_allclose(expected[optimal], 0, atol=1e-10)
    assert np.all(expected[~optimal] < -1e-9)


class TestTheorem31:
    """Φ = V*: the expected shaped reward is the advantage, which is zero exactly for the optimal actions."""

    @given(seeds, gammas)
    def test_only_optimal_actions_have_zero_shaped_reward(self, seed, gamma):
        check_optimal_credit_assignment(seed, gamma)

    @pytest.mark.slow
    def test_a_thousand_times(self):
        for seed in range(1000):
            check_optimal_credit_assignment(seed, 0.95)

    @given(seeds)
    def test_nothing_remains_to_be_learned_of_v(self, seed):
        mdp = random_mdp(seed)
        shaped = solve(mdp, shaping_rewards(mdp, solve(mdp).v))
        np.testing.assert_allclose(shaped.v[mdp.ordinary], 0, atol=1e-10)
