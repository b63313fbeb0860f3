"""Families of host environments: the same transitions as the compiled ones, spaces, tasks, processes, and bad input."""

import functools

import equinox as eqx
import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Text, Tuple

from support import host
from support.comparing import assert_trees_identical
from upslope import GymnasiumTasks, UpslopeError
from upslope.envs.cartpole import CartPole, CartPoleState
from upslope.learners.policies import EpsilonGreedy, Greedy, Noisy
from upslope.networks.actor_critic import Actor
from upslope.networks.dueling import DuelingQ
from upslope.networks.q_network import QNetwork
from upslope.tasks import cartpoles
from upslope.tasks.actions import ContinuousActions, DiscreteActions

POLES = GymnasiumTasks(host.length, host.short_pole, 0.9, name="cartpole", observation_scale=host.SCALE)
NETWORK = DuelingQ(jax.random.key(0), 4, 2, (8, 8), host.SCALE, "tanh")
POLICY = EpsilonGreedy(NETWORK, 0.3)
KEYS = jax.random.split(jax.random.key(1), 4)


def lamps(space=None, actions=None, *, kind=host.Lamp, sample=None, **settings):
    make = functools.partial(kind, observation_space=space or host.vectors(), action_space=actions)
    return GymnasiumTasks(sample or (lambda rng: rng.integers(1, 9)), make, 0.5, **{"max_steps": 5} | settings)


@pytest.fixture(scope="module")
def collected():
    tasks = POLES.sample_many(KEYS[0], 3)
    running = POLES.reset(KEYS[1], tasks)
    running, first = POLES.collect(KEYS[2], tasks, running, POLICY, 40)
    running, second = POLES.collect(KEYS[3], tasks, running, POLICY, 20)
    return tasks, first, second


class TestParity:
    def test_every_transition_matches_the_compiled_environment(self, collected):
        tasks, first, _ = collected
        env, sampler = CartPole(), cartpoles().sample_params

        def step(length, obs, action):
            state = CartPoleState(obs, jnp.zeros((), jnp.int32))
            _, _, reward, terminated, _, info = env.step(jax.random.key(0), state, action, sampler.with_length(length))
            return info["final_observation"], reward, 0.9 * (1 - terminated)

        for index, words in enumerate(tasks):
            length = jnp.asarray(POLES.task_of(words), jnp.float32)
            ours = jax.jit(jax.vmap(step, in_axes=(None, 0, 0)))(length, first.obs[index], first.action[index])
            np.testing.assert_allclose(first.next_obs[index], ours[0], rtol=1e-4, atol=2e-5)
            np.testing.assert_array_equal(first.reward[index], ours[1])
            np.testing.assert_allclose(first.discount[index], ours[2], rtol=1e-6)

    def test_both_back_ends_give_the_same_episodes(self):
        """With the same states, keys and policy, up to the first reset; the back ends draw different starts."""
        family = cartpoles(max_steps=12, gamma=0.9)
        tasks = POLES.sample_many(KEYS[0], 3)
        lengths = jnp.asarray([POLES.task_of(words) for words in tasks], jnp.float32)
        theirs = jax.vmap(family.sample_params.with_length)(lengths)
        host_running = POLES.reset(KEYS[1], tasks)
        _, on_host = POLES.collect(KEYS[2], tasks, host_running, POLICY, 12)
        running = family.reset(KEYS[1], theirs)
        start = on_host.obs[:, 0]
        running = eqx.tree_at(lambda running: (running.obs, running.state.physics), running, (start, start))
        _, compiled = family.collect(KEYS[2], theirs, running, POLICY, 12)
        for index in range(3):
            ended = np.flatnonzero(np.asarray(on_host.discount[index]) == 0)
            until = int(ended[0]) + 1 if ended.size else 12
            assert until > 5
            for name in ("obs", "action", "reward", "discount", "next_obs"):
                compiled_values, host_values = (
                    np.asarray(getattr(batch, name))[index, :until] for batch in (compiled, on_host)
                )
                np.testing.assert_allclose(compiled_values, host_values, rtol=1e-4, atol=2e-5)

    def test_episodes_end_and_continue_as_learners_expect(self, collected):
        _, first, second = collected
        obs = np.concatenate([first.obs, second.obs], axis=1)
        following = np.concatenate([first.next_obs, second.next_obs], axis=1)
        position, angle = following[..., 0], following[..., 2]
        terminated = (np.abs(position) > 2.4) | (np.abs(angle) > np.radians(15))
        discount = np.concatenate([first.discount, second.discount], axis=1)
        np.testing.assert_allclose(discount, np.where(terminated, 0.0, 0.9), rtol=1e-6)
        ended, taken = np.zeros_like(terminated), np.zeros(3, int)
        for t in range(60):
            taken += 1
            ended[:, t] = terminated[:, t] | (taken >= 12)
            taken[ended[:, t]] = 0
        assert terminated.any()
        assert (ended & ~terminated).any(), "some truncated, some terminated"
        chained = np.all(following[:, :-1] == obs[:, 1:], axis=-1)
        np.testing.assert_array_equal(chained, ~ended[:, :-1])

    def test_returns_of_a_scripted_policy(self):
        family = GymnasiumTasks(host.length, host.pole, 0.9)
        tasks = family.sample_many(KEYS[0], 4)

        def follow_the_pole(key, obs):
            return (obs[:, 2] + 0.3 * obs[:, 3] > 0).astype(int)

        np.testing.assert_array_equal(family.returns(KEYS[1], tasks, follow_the_pole), 200)
        fallen = family.returns(KEYS[1], tasks, lambda key, obs: jnp.ones(len(obs), int))
        assert 5 < float(fallen.min()) <= float(fallen.max()) < 100

    def test_seeded(self, collected):
        tasks, first, _ = collected
        again = GymnasiumTasks(host.length, host.short_pole, 0.9, observation_scale=host.SCALE)
        running = again.reset(KEYS[1], again.sample_many(KEYS[0], 3))
        assert_trees_identical(again.collect(KEYS[2], tasks, running, POLICY, 40)[1], first)

    def test_worker_processes_give_the_same_transitions(self, collected):
        tasks = collected[0]
        family = GymnasiumTasks(host.length, host.short_pole, 0.9, mode="async")
        rollouts = [some.rollout(KEYS[3], tasks[:2], POLICY, 15) for some in (family, POLES)]
        other = family.rollout(KEYS[3], tasks[1:], POLICY, 15)
        family.close()
        assert_trees_identical(rollouts[0], rollouts[1])
        assert not np.array_equal(other.next_obs, rollouts[0].next_obs), "the workers got their new tasks"


@pytest.mark.parametrize(
    "policy",
    [
        Greedy(NETWORK),
        Greedy(QNetwork(KEYS[0], 4, 3, (8,))),
        EpsilonGreedy(NETWORK, 0.5),
        EpsilonGreedy(NETWORK, jnp.linspace(0.1, 0.9, 5)),
        Noisy(Actor(KEYS[0], 4, 2), 0.3),
        Greedy(Actor(KEYS[0], 4, 2)),
    ],
    ids=lambda policy: type(policy).__name__,
)
def test_policies_in_numpy_act_as_in_jax(policy):
    obs = np.random.default_rng(0).normal(size=(6, 5, 4)).astype(np.float32)
    keys = jax.random.split(KEYS[3], 6)
    expected = [np.asarray(policy(key, jnp.asarray(one))) for key, one in zip(keys, obs, strict=True)]
    act = policy.on_host(keys, len(obs[0]))()
    np.testing.assert_allclose([act(step, one) for step, one in enumerate(obs)], expected, rtol=0, atol=1e-6)


class Ones(eqx.Module):
    """A network without a NumPy form, whose best action is 1."""

    def best(self, obs):
        return jnp.argmax(jnp.array([0.0, 1.0, 0.0]) * (2 + obs[0]))

    def random_actions(self, key, count):
        return jnp.zeros(count, int)


def test_policies_without_a_numpy_form_are_called_compiled():
    family = lamps()
    tasks = family.sample_many(KEYS[0], 2)
    policy = EpsilonGreedy(Ones(), 0.0)
    assert policy.on_host(KEYS, 2) is None
    np.testing.assert_array_equal(family.rollout(KEYS[0], tasks, policy, 4).action, 1)


class TestTasks:
    def test_a_task_can_be_redrawn_from_its_key_words(self):
        tasks = POLES.sample_many(KEYS[0], 50)
        assert tasks.shape == (50, 2)
        lengths = [POLES.task_of(words) for words in tasks]
        assert lengths == [POLES.task_of(words) for words in tasks]
        assert 0.25 <= min(lengths) < 1.0 < 4.0 < max(lengths) <= 5.0

    def test_each_environment_gets_a_different_task(self):
        family = lamps()
        tasks = family.sample_many(KEYS[0], 4)
        rewards = family.rollout(KEYS[1], tasks, Greedy(QNetwork(KEYS[0], 2, 3)), 4).reward
        expected = [float(family.task_of(words)) for words in tasks]
        np.testing.assert_array_equal(rewards, np.repeat(np.asarray(expected)[:, None], 4, axis=1))
        assert len(set(expected)) > 1
        returns = family.returns(KEYS[1], tasks, Greedy(QNetwork(KEYS[0], 2, 3)))
        np.testing.assert_array_equal(returns, 3 * np.asarray(expected))

    def test_the_older_protocol(self):
        before = np.random.get_state()[1].copy()  # noqa: NPY002
        family = GymnasiumTasks.from_protocol(host.OldStyle, 0.5, max_steps=5)
        tasks = family.sample_many(KEYS[0], 3)
        drawn = [family.task_of(words) for words in tasks]
        assert drawn == [family.task_of(words) for words in tasks]
        assert all(1 <= task <= 2 for task in drawn)
        assert len(set(drawn)) == 3
        rewards = family.rollout(KEYS[1], tasks, Greedy(QNetwork(KEYS[0], 2, 3)), 2).reward
        np.testing.assert_allclose(rewards[:, 0], drawn, rtol=1e-6)
        np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002

    def test_the_older_protocol_unseeded_or_missing(self):
        with pytest.raises(UpslopeError, match="for the same seed"):
            GymnasiumTasks.from_protocol(host.Unseeded, 0.5, max_steps=5)
        with pytest.raises(UpslopeError, match="no sample_tasks and set_task"):
            GymnasiumTasks.from_protocol(lambda: gym.make("CartPole-v1"), 0.5)


class TestSpaces:
    @pytest.mark.parametrize(
        ("space", "numbers"),
        [
            (Box(-1, 1, (3,), np.float64), 3),
            (Box(-1, 1, (2, 3), np.float32), 6),
            (Box(0, 255, (4,), np.uint8), 4),
            (Discrete(5), 5),
            (MultiBinary(4), 4),
            (MultiDiscrete([2, 3]), 5),
            (Dict({"a": Discrete(2), "b": Box(-1, 1, (3,))}), 5),
            (Tuple([Discrete(2), Discrete(3)]), 5),
        ],
        ids=str,
    )
    def test_observations_become_one_vector(self, space, numbers):
        family = lamps(space)
        assert family.observation_shape == (numbers,)
        batch = family.rollout(KEYS[0], family.sample_many(KEYS[1], 2), Greedy(QNetwork(KEYS[0], numbers, 3)), 7)
        assert batch.obs.shape == (2, 7, numbers)
        if isinstance(space, Discrete):
            np.testing.assert_array_equal(np.sort(batch.obs, axis=-1)[..., -1], 1)
            np.testing.assert_array_equal(np.sum(batch.obs, axis=-1), 1)

    def test_actions(self):
        made = []

        def make(task):
            low, high = np.array([[0.0, -4.0], [2.0, 4.0]], np.float32)
            made.append(host.Lamp(task, host.vectors(), Box(low, high)))
            return made[-1]

        family = GymnasiumTasks(lambda rng: 1, make, 0.5, max_steps=5)
        assert family.actions == ContinuousActions(2)
        family.rollout(KEYS[0], family.sample_many(KEYS[1], 1), lambda key, obs: jnp.array([[1.0, -0.5]]), 2)
        np.testing.assert_allclose(made[-1].seen, [[2.0, -2.0]] * 2)

    def test_discrete_actions_that_start_elsewhere(self):
        family = lamps(actions=Discrete(3, start=5))
        assert family.actions == DiscreteActions(3)
        batch = family.rollout(KEYS[0], family.sample_many(KEYS[1], 1), lambda key, obs: jnp.array([2]), 2)
        np.testing.assert_array_equal(batch.action, 2)

    @pytest.mark.parametrize(
        "actions",
        [MultiDiscrete([2, 2]), Box(-np.inf, np.inf, (2,)), Box(-1, 1, (2, 2)), Box(0, 10, (1,), np.int64)],
        ids=str,
    )
    def test_actions_that_are_not_supported(self, actions):
        with pytest.raises(UpslopeError, match=r"Actions of .* are not supported"):
            lamps(actions=actions)

    def test_observations_that_are_not_supported(self):
        with pytest.raises(UpslopeError, match="can't be flattened"):
            lamps(gym.spaces.Sequence(Discrete(2)))

    def test_text_is_flattened_by_gymnasium(self):
        assert lamps(Text(3, charset="ab")).observation_shape == (3,)

    def test_scale_comes_from_informative_bounds(self):
        space = Box(np.array([-4.0, -np.inf, 0.0, -1e6]), np.array([2.0, 1.0, 50.0, 1e6]), dtype=np.float64)
        assert lamps(space).observation_scale == (0.25, 1.0, 0.02, 1.0)


class TestBadInput:
    def test_a_sampler_that_raises(self):
        with pytest.raises(UpslopeError, match="sampler of tasks failed .ZeroDivisionError"):  # noqa: RUF043
            lamps(sample=lambda rng: 1 / 0)

    def test_a_factory_that_raises_for_some_tasks(self):
        def make(task):
            if task < 4:
                raise RuntimeError("no such lamp")
            return host.Lamp(task, host.vectors())

        family = GymnasiumTasks(lambda rng: int(rng.integers(1, 9)), make, 0.5, max_steps=5)
        with pytest.raises(UpslopeError, match=r"make_env failed for the task \d \(RuntimeError: no such lamp\)"):
            family.rollout(KEYS[0], family.sample_many(KEYS[1], 8), Greedy(QNetwork(KEYS[0], 2, 3)), 2)

    def test_a_factory_that_returns_no_environment(self):
        with pytest.raises(UpslopeError, match="make_env returned int"):
            GymnasiumTasks(lambda rng: 1, lambda task: task, 0.5)

    def test_tasks_with_other_spaces(self):
        def make(task):
            return host.Lamp(task, host.vectors(int(task)))

        family = GymnasiumTasks(lambda rng: rng.integers(1, 9), make, 0.5, max_steps=5)
        with pytest.raises(UpslopeError, match="a family shares its spaces"):
            family.rollout(KEYS[0], family.sample_many(KEYS[1], 8), lambda key, obs: jnp.zeros(8, int), 2)

    @pytest.mark.parametrize("mode", ["sync", "async"])
    @pytest.mark.filterwarnings("ignore:.*:UserWarning")
    def test_an_observation_that_changes_its_shape_midway(self, mode):
        family = lamps(kind=host.Growing, mode=mode)
        with pytest.raises(UpslopeError, match=r"observation of shape \(3,\), but its observation space says \(2,\)"):
            family.rollout(KEYS[0], family.sample_many(KEYS[1], 1), lambda key, obs: jnp.zeros(1, int), 3)
        family.close()

    def test_a_worker_that_dies(self):
        family = lamps(kind=host.Dying, mode="async")
        with pytest.raises(UpslopeError, match="worker process of the vector environment died"):
            family.rollout(KEYS[0], family.sample_many(KEYS[1], 1), lambda key, obs: jnp.zeros(1, int), 3)
        family.close()

    def test_calls_from_a_compiled_program_are_refused(self):
        with pytest.raises(UpslopeError, match="can't run inside a compiled program"):
            jax.jit(lambda key: POLES.reset(key, POLES.sample_many(key, 2)))(KEYS[0])

    @pytest.mark.parametrize(
        ("settings", "words"),
        [
            ({"max_steps": None}, "give max_steps"),
            ({"mode": "sync", "observation_scale": (1.0,)}, "observation_scale has 1 numbers: give 2"),
        ],
    )
    def test_settings(self, settings, words):
        with pytest.raises(UpslopeError, match=words):
            lamps(**settings)

    @pytest.mark.parametrize("gamma", [0.0, 1.5, float("nan")])
    def test_invalid_discounts(self, gamma):
        with pytest.raises(UpslopeError, match="gamma is"):
            GymnasiumTasks(host.length, host.pole, gamma)
