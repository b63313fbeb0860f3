"""Policies: greedy, ε-greedy with one ε or one for each environment, noisy actors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.scores import Fixed, Scores
from upslope.learners.policies import EpsilonGreedy, Greedy, HeldActions, Noisy

MANY = 20_000


def same(obs):
    """The identity: observations are scores or actions."""
    return obs


SCORES, ACTOR = Scores(same, 4), Fixed(same)


@pytest.fixture(scope="module")
def obs():
    return jax.random.normal(jax.random.key(0), (MANY, 4))


def act(policy, obs, seed=1):
    return np.asarray(policy(jax.random.key(seed), obs))


def test_greedy_takes_the_highest_score():
    obs = jnp.array([[1.0, 3.0, 2.0], [0.0, -1.0, -2.0]])
    assert act(Greedy(Scores(same, 3)), obs).tolist() == [1, 0]


def test_greedy_is_indifferent_to_keys(obs):
    np.testing.assert_array_equal(act(Greedy(SCORES), obs, seed=1), act(Greedy(SCORES), obs, seed=2))


@pytest.mark.parametrize("epsilon", [0.1, 0.6])
def test_epsilon_is_the_share_of_uniformly_random_actions(obs, epsilon):
    # A random action is the greedy one a quarter of the time.
    strayed = act(EpsilonGreedy(SCORES, epsilon), obs) != obs.argmax(-1)
    assert strayed.mean() == pytest.approx(0.75 * epsilon, abs=0.012)  # four standard deviations at most


def test_without_epsilon_it_is_greedy(obs):
    np.testing.assert_array_equal(act(EpsilonGreedy(SCORES, 0.0), obs), obs.argmax(-1))


def test_with_epsilon_one_every_action_is_equally_likely(obs):
    shares = np.bincount(act(EpsilonGreedy(SCORES, 1.0), obs), minlength=4) / MANY
    np.testing.assert_allclose(shares, 0.25, atol=0.013)


def test_each_environment_can_have_its_own_epsilon(obs):
    epsilon = jnp.linspace(0, 1, MANY)
    strayed = act(EpsilonGreedy(SCORES, epsilon), obs) != obs.argmax(-1)
    # Means of ε over the first and the last quarter of environments: 1/8 and 7/8.
    assert strayed[: MANY // 4].mean() == pytest.approx(0.75 / 8, abs=0.02)
    assert strayed[-MANY // 4 :].mean() == pytest.approx(0.75 * 7 / 8, abs=0.03)


def test_environments_explore_independently(obs):
    policy = EpsilonGreedy(SCORES, 0.5)
    first, second = (act(policy, obs, seed) != obs.argmax(-1) for seed in (1, 2))
    # Each of two draws deviates with probability 0.375, so both do with 0.375².
    assert (first & second).mean() == pytest.approx(0.375**2, abs=0.012)


class TestActors:
    actions = jnp.linspace(-1, 1, MANY)[:, None]

    def test_greedy_takes_the_actor_s_own_action(self):
        np.testing.assert_array_equal(act(Greedy(ACTOR), self.actions), self.actions)

    def test_zero_noise_changes_nothing(self):
        np.testing.assert_array_equal(act(Noisy(ACTOR, 0.0), self.actions), self.actions)

    def test_noise_is_clipped_to_the_range_of_actions(self):
        noisy = act(Noisy(ACTOR, 0.5), self.actions)
        assert np.abs(noisy).max() == 1.0
        assert (np.abs(noisy) == 1.0).mean() > 0.1

    def test_noise_is_centred_with_standard_deviation_sigma(self):
        noise = act(Noisy(ACTOR, 0.1), jnp.zeros((MANY, 1)))
        assert noise.mean() == pytest.approx(0, abs=0.003)
        assert noise.std() == pytest.approx(0.1, abs=0.003)


def test_a_network_without_a_numpy_form_is_refused_on_the_host():
    assert Greedy(SCORES).on_host(jax.random.split(jax.random.key(0), 2), 3) is None


class TestHeldActions:
    """Scores have their highest entry last, so that action 3 is the greedy one."""

    STEPS, COUNT = 400, 500

    def actions(self, epsilon, longest, steps=STEPS):
        policy = HeldActions(SCORES, epsilon, longest)
        noise, act = policy.ahead(jax.random.split(jax.random.key(3), steps), jnp.zeros((self.COUNT, 4)))
        obs = jnp.tile(jnp.arange(4.0), (self.COUNT, 1))
        return np.asarray(jax.vmap(lambda drawn: act(drawn, obs))(noise)), np.asarray(noise[0])

    def test_lengths_have_the_stated_distribution(self):
        _, explores = self.actions(0.02, 4)
        padded = np.pad(explores, ((1, 1), (0, 0)))
        lengths = []
        for column in padded.T:
            edges = np.flatnonzero(np.diff(column.astype(int)))
            lengths += [end - begin for begin, end in edges.reshape(-1, 2) if end < self.STEPS]
        shares = np.bincount(lengths, minlength=5)[1:5] / len(lengths)
        # With ε small, two holds rarely follow one another without a greedy step between.
        expected = np.arange(1, 5) ** -1.5 / (np.arange(1, 5) ** -1.5).sum()
        np.testing.assert_allclose(shares, expected, atol=0.025)

    def test_an_action_is_held(self):
        actions, explores = self.actions(1.0, 50)
        assert explores.all()
        changed = (np.diff(actions, axis=0) != 0).mean()
        mean_length = (np.arange(1, 51) ** -0.5).sum() / (np.arange(1, 51) ** -1.5).sum()
        assert changed == pytest.approx(0.75 / mean_length, rel=0.05)  # a quarter of new actions are the old one

    def test_at_full_exploration_every_action_is_equally_frequent(self):
        actions, _ = self.actions(1.0, 3)
        np.testing.assert_allclose(np.bincount(actions.ravel(), minlength=4) / actions.size, 0.25, atol=0.01)

    def test_with_a_longest_hold_of_one_steps_are_independent(self):
        _, explores = self.actions(0.3, 1)
        assert explores.mean() == pytest.approx(0.3, abs=0.01)
        assert (explores[1:] & explores[:-1]).mean() == pytest.approx(0.09, abs=0.005)

    def test_each_environment_has_its_own_epsilon(self):
        _, explores = self.actions(jnp.linspace(0, 1, self.COUNT), 1)
        np.testing.assert_allclose(explores.mean(0), np.linspace(0, 1, self.COUNT), atol=0.1)

    def test_on_the_host_it_draws_the_same(self):
        policy = HeldActions(SCORES, 0.4, 10)
        keys = jax.random.split(jax.random.key(3), 30)
        (held, actions), _ = policy.ahead(keys, jnp.zeros((7, 4)))
        on_host = jax.jit(lambda keys: policy.noises(keys, 7))(keys)
        np.testing.assert_array_equal(np.where(held, actions, -1), np.where(on_host[0], on_host[1], -1))
