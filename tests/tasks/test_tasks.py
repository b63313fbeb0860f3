"""Families: settings that are refused, sampling, equality, and the guarantees of collecting."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_identical
from support.poles import gymnasium_trajectory, gymnasium_twin
from upslope.envs.cartpole import CartPole
from upslope.errors import UpslopeError
from upslope.learners.policies import EpsilonGreedy, Greedy
from upslope.networks.dueling import DuelingQ
from upslope.priors.potentials import stack
from upslope.tasks import cartpoles
from upslope.tasks.actions import ContinuousActions, DiscreteActions


def pole(length):
    """The task of the paper's family with this length."""
    return cartpoles().sample_params.with_length(length)


class TestSettings:
    @pytest.mark.parametrize(
        "length",
        [(5.0, 0.25), (-1.0, 2.0), (0.0, 2.0), (float("nan"), 2.0), (1.0, float("nan")), (1.0, float("inf"))],
        ids=str,
    )
    def test_invalid_ranges_of_lengths(self, length):
        with pytest.raises(UpslopeError, match=r"pole lengths .* no range"):
            cartpoles(length)

    @pytest.mark.parametrize("gamma", [0.0, -0.5, 1.01, float("nan")])
    def test_invalid_discounts(self, gamma):
        with pytest.raises(UpslopeError, match="gamma is"):
            cartpoles(gamma=gamma)

    @pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
    @pytest.mark.parametrize("name", ["angle_limit_degrees", "track_limit"])
    def test_invalid_limits(self, name, value):
        with pytest.raises(UpslopeError, match="must all be positive"):
            cartpoles(**{name: value})

    def test_invalid_numbers_of_steps(self):
        with pytest.raises(UpslopeError, match="must all be positive"):
            cartpoles(max_steps=0)

    def test_a_single_length_is_a_range(self):
        assert float(cartpoles((2.0, 2.0)).sample(jax.random.key(0)).length) == 2.0

    def test_the_defaults_are_the_paper_s(self):
        family = cartpoles()
        task = family.sample(jax.random.key(0))
        assert float(task.angle_limit) == pytest.approx(15 * np.pi / 180)
        assert (family.actions, family.max_steps, family.observation_shape) == (DiscreteActions(2), 200, (4,))

    def test_the_continuous_twin_shares_the_name_and_the_tasks(self):
        discrete, continuous = cartpoles(), cartpoles(continuous=True)
        assert discrete.name == continuous.name
        assert continuous.actions == ContinuousActions(1)
        assert_trees_identical(discrete.sample(jax.random.key(3)), continuous.sample(jax.random.key(3)))


class TestSampling:
    def test_lengths_are_uniform_over_the_range(self):
        lengths = np.asarray(cartpoles((0.25, 5.0)).sample_many(jax.random.key(0), 4000).length)
        assert lengths.min() >= 0.25
        assert lengths.max() <= 5.0
        counts, _ = np.histogram(lengths, bins=4, range=(0.25, 5.0))
        np.testing.assert_allclose(counts / 4000, 0.25, atol=0.03)  # 4 standard deviations are 0.027

    def test_half_length_is_half_of_the_pole(self):
        half, whole = cartpoles((0.25, 2.5), half_length=True), cartpoles((0.5, 5.0))
        assert_trees_identical(half.sample(jax.random.key(1)), whole.sample(jax.random.key(1)))

    def test_a_batch_of_tasks_is_a_stack_of_single_draws(self):
        family, key = cartpoles(), jax.random.key(2)
        singles = stack([family.sample(k) for k in jax.random.split(key, 5)])
        assert_trees_identical(family.sample_many(key, 5), singles)
        assert len(set(singles.length.tolist())) == 5


class TestEquality:
    def test_equal_settings_make_equal_families(self):
        assert cartpoles(gamma=0.9) == cartpoles(gamma=0.9)
        assert hash(cartpoles()) == hash(cartpoles())
        assert cartpoles() != cartpoles((0.25, 4.0))
        assert cartpoles() != cartpoles(gamma=0.9)

    def test_equal_families_share_a_compiled_program(self):
        traced = []

        @jax.jit
        def draw(family, key):
            traced.append(family)
            return family.sample(key)

        for family in (cartpoles(), cartpoles(), cartpoles(length=(0.25, 5.0))):
            draw(family, jax.random.key(0))
        assert len(traced) == 1
        draw(cartpoles(length=(0.25, 4.0)), jax.random.key(0))
        assert len(traced) == 2


#: A step limit of 12 truncates some episodes of random actions; the others terminate.
SHORT, COUNT, STEPS = cartpoles(max_steps=12, gamma=0.9), 3, 60


@pytest.fixture(scope="module")
def collected():
    def policy(key, obs):
        return jax.random.bernoulli(key, 0.75, obs.shape[:1]).astype(int)

    tasks = SHORT.sample_many(jax.random.key(0), COUNT)
    running = SHORT.reset(jax.random.key(1), tasks)
    return jax.jit(lambda key: SHORT.collect(key, tasks, running, policy, STEPS))(jax.random.key(2))


@pytest.fixture(scope="module")
def ends(collected):
    """Terminated and truncated ``[count, steps]``, recomputed from the true successors and by counting."""
    position, _, angle, _ = np.moveaxis(np.asarray(collected[1].next_obs), -1, 0)
    terminated = (np.abs(position) > 2.4) | (np.abs(angle) > np.radians(15))
    truncated, taken = np.zeros_like(terminated), np.zeros(COUNT, int)
    for t in range(STEPS):
        taken += 1
        truncated[:, t] = (taken >= 12) & ~terminated[:, t]
        taken[terminated[:, t] | truncated[:, t]] = 0
    assert terminated.any(), "nothing would be tested"
    assert truncated.any(), "nothing would be tested"
    return terminated, truncated


class TestCollecting:
    def test_shapes(self, collected):
        _, batch = collected
        assert batch.obs.shape == batch.next_obs.shape == (3, 60, 4)
        assert batch.action.shape == batch.reward.shape == batch.discount.shape == (3, 60)

    def test_discount_is_zero_exactly_at_terminations(self, collected, ends):
        np.testing.assert_allclose(collected[1].discount, np.where(ends[0], 0.0, 0.9), rtol=1e-6)

    def test_observations_chain_unless_an_episode_ended(self, collected, ends):
        _, batch = collected
        ended = (ends[0] | ends[1])[:, :-1]
        chained = np.all(np.asarray(batch.next_obs)[:, :-1] == np.asarray(batch.obs)[:, 1:], axis=-1)
        np.testing.assert_array_equal(chained, ~ended)
        assert np.all(np.abs(np.asarray(batch.obs)[:, 1:][ended]) <= 0.05), "an episode begins near the middle"

    def test_the_running_environments_continue_from_the_last_step(self, collected, ends):
        running, batch = collected
        going_on = ~(ends[0] | ends[1])[:, -1]
        np.testing.assert_array_equal(running.obs[going_on], batch.next_obs[:, -1][going_on])
        assert running.obs.shape == (3, 4)


class TestDrawingAhead:
    """Policies with noise drawn in advance act like policies that draw noise at each step."""

    tasks = stack([pole(length) for length in (0.5, 1.0, 3.0)])

    @pytest.mark.parametrize("kind", [EpsilonGreedy, pytest.param(Greedy, marks=pytest.mark.slow)])
    def test_the_same_steps(self, kind):
        family = cartpoles(gamma=0.9)
        network = DuelingQ(jax.random.key(1), 4, 2)
        policy = kind(network, jnp.linspace(0.1, 0.9, 3)) if kind is EpsilonGreedy else kind(network)
        as_function = lambda key, obs: policy(key, obs)  # noqa: E731

        def trial(policy):
            batch = family.rollout(jax.random.key(2), self.tasks, policy, 40)
            return batch, family.returns(jax.random.key(3), self.tasks, policy)

        drawn_ahead, drawn_in_turn = (jax.jit(lambda p=p: trial(p))() for p in (policy, as_function))
        np.testing.assert_array_equal(drawn_ahead[0].action, drawn_in_turn[0].action)
        np.testing.assert_allclose(drawn_ahead[0].next_obs, drawn_in_turn[0].next_obs, rtol=1e-6)
        np.testing.assert_array_equal(drawn_ahead[1], drawn_in_turn[1])
        assert len(np.unique(drawn_ahead[0].action)) == 2


class TestReturns:
    lengths = np.linspace(0.25, 5.0, 16)
    tasks = stack([pole(float(length)) for length in lengths])

    def returns(self, policy, key):
        return np.asarray(jax.jit(lambda key: cartpoles().returns(key, self.tasks, policy))(key))

    def test_a_scripted_policy_balances_every_pole_to_the_end(self):
        def follow_the_pole(key, obs):
            return (obs[:, 2] + 0.3 * obs[:, 3] > 0).astype(int)

        np.testing.assert_array_equal(self.returns(follow_the_pole, jax.random.key(0)), 200)

    @pytest.mark.parametrize("action", [0, 1])
    def test_a_constant_push_earns_what_it_does_in_gymnasium(self, action):
        key = jax.random.key(5)
        ours = self.returns(lambda _, obs: jnp.full(len(obs), action), key)
        # The starts are those of the family's own reset, by the first half of the key.
        starts = cartpoles().reset(jax.random.split(key)[0], self.tasks).obs
        for length, start, total in zip(self.lengths, starts, ours, strict=True):
            twin = gymnasium_twin(float(np.float32(length)))
            assert total == len(gymnasium_trajectory(twin, np.asarray(start), [action] * 200))
        assert len(set(ours.tolist())) > 3, "long poles fall slowly"


class TestFamilyOfOne:
    task = cartpoles().sample(jax.random.key(4))

    def test_every_draw_is_the_same_task(self):
        family = SHORT.only(self.task)
        assert_trees_identical(family.sample(jax.random.key(0)), self.task)
        assert family.sample_many(jax.random.key(0), 3).length.tolist() == [float(self.task.length)] * 3

    def test_all_other_properties_are_unchanged(self):
        family = SHORT.only(self.task)
        for name in ("name", "gamma", "observation_shape", "observation_scale", "actions", "max_steps"):
            assert getattr(family, name) == getattr(SHORT, name)

    def test_families_of_one_stack(self):
        together = stack([SHORT.only(pole(length)) for length in (1.0, 2.0)])
        drawn = jax.vmap(lambda family: family.sample(jax.random.key(0)))(together)
        assert drawn.length.tolist() == [1.0, 2.0]


def test_environments_compare_by_value():
    assert CartPole() == CartPole()
    assert CartPole() != CartPole(continuous=True)
