"""Families of third-party JAX environments: hand-computed transitions, gymnax's environments, xminigrid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import upslope
from support.counting import Counting, OldStyle, Params
from upslope.envs.time_steps import TimeStepEnvironment
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.networks.convolutional import ConvolutionalTorso
from upslope.tasks.actions import ContinuousActions

KEY = jax.random.key(0)
SMALL = MetaTrainingConfig(
    tasks=2,
    steps_per_task=8,
    hidden=(8,),
    outer_updates=1,
    evaluation_tasks=2,
    posterior=NetworkPosterior(batch_size=4),
)


def counting(goal=4, **settings):
    return upslope.gymnax_tasks(Counting(**settings), lambda key: Params(goal), 0.9)


def always(action):
    return lambda key, obs: jnp.full(len(obs), action)


def randomly(actions):
    return lambda key, obs: jax.random.randint(key, (len(obs),), 0, actions)


@eqx.filter_jit
def rollout(family, policy, steps, tasks=2):
    drawn = family.sample_many(jax.random.key(1), tasks)
    return family.rollout(jax.random.key(2), drawn, policy, steps)


class TestByHand:
    def test_termination_zeroes_the_discount_and_the_reset_observation_is_not_the_successor(self):
        batch = rollout(counting(), always(2), 5)
        np.testing.assert_array_equal(batch.obs[0, :, 0], [0, 2, 0, 2, 0])
        np.testing.assert_array_equal(batch.next_obs[0, :, 0], [2, 4, 2, 4, 2])
        np.testing.assert_allclose(batch.discount[0], [0.9, 0, 0.9, 0, 0.9])
        np.testing.assert_array_equal(batch.reward[0], [-2, -4, -2, -4, -2])

    def test_truncation_keeps_the_discount(self):
        batch = rollout(counting(goal=100), always(1), 8)
        np.testing.assert_array_equal(batch.next_obs[0, :, 0], [1, 2, 3, 4, 5, 6, 1, 2])
        np.testing.assert_allclose(batch.discount[0], 0.9)

    def test_both_at_once_is_termination(self):
        family = counting(goal=6)
        np.testing.assert_allclose(rollout(family, always(1), 7).discount[0], [0.9] * 5 + [0.0, 0.9])
        *_, terminated, truncated, _ = family.env.step(KEY, (jnp.array(5), jnp.array(5)), 1, Params(6))
        assert (bool(terminated), bool(truncated)) == (True, False)

    def test_tasks_are_parameters(self):
        family = upslope.gymnax_tasks(Counting(), lambda key: Params(jax.random.randint(key, (), 2, 5)), 0.9)
        tasks = family.sample_many(KEY, 20)
        assert set(np.asarray(tasks.goal)) == {2, 3, 4}
        batch = family.rollout(KEY, tasks, always(1), 4)
        first_ends = np.argmax(np.asarray(batch.discount) == 0, axis=1)
        np.testing.assert_array_equal(first_ends + 1, tasks.goal)
        np.testing.assert_array_equal(
            family.returns(KEY, tasks, always(1)), [-goal * (goal + 1) / 2 for goal in tasks.goal]
        )

    @pytest.mark.parametrize(
        ("observes", "shape", "scale"),
        [
            ("vector", (2,), (0.02, 0.02)),
            ("number", (10,), (1.0,) * 10),
            ("image", (3, 4, 2), (1 / 255, 1 / 255)),
            ("parts", (5,), (1.0,) * 5),
        ],
    )
    def test_observations(self, observes, shape, scale):
        family = counting(observes=observes)
        assert (family.observation_shape, family.observation_scale) == (shape, scale)
        batch = rollout(family, always(1), 3)
        assert batch.obs.shape == (2, 3, *shape)
        expected = {
            "number": np.eye(10)[2],
            "image": np.full(shape, 2.0),
            "parts": [2, 0.5, 0.5, 0.5, 0.5],
            "vector": [2, 4],
        }
        np.testing.assert_allclose(batch.obs[0, 2], expected[observes])

    def test_continuous_actions_are_scaled_to_the_bounds(self):
        family = counting(push=4.0)
        assert family.actions == ContinuousActions(1)
        batch = rollout(family, lambda key, obs: jnp.full((len(obs), 1), 0.5), 1)
        np.testing.assert_array_equal(batch.next_obs[0, 0, 0], 3)

    def test_images_get_a_convolutional_network(self):
        theta = eqx.filter_eval_shape(MetaTraining(counting(observes="image"), SMALL).init, KEY).theta
        assert isinstance(theta.torso, ConvolutionalTorso)

    @pytest.mark.parametrize(
        ("env", "sample", "settings", "words"),
        [
            (OldStyle(), lambda key: Params(4), {}, r"gives 5 values.*gymnax does from 1\.0 on"),
            (Counting(), lambda key: 1 / 0, {}, r"sampler of parameters failed \(ZeroDivisionError"),
            (Counting(), lambda key: Params(4, 0), {}, "give max_steps"),
            (Counting(), lambda key: {"goal": 4}, {"max_steps": 4}, r"can't be traced \(AttributeError"),
            (Counting(), lambda key: Params(4), {"observation_scale": (1.0,)}, "has 1 numbers: give 2"),
            (Counting(push=float("inf")), lambda key: Params(4), {}, "not supported"),
        ],
    )  # fmt: skip
    def test_bad_input(self, env, sample, settings, words):
        with pytest.raises(upslope.UpslopeError, match=words):
            upslope.gymnax_tasks(env, sample, 0.9, **settings)

    @pytest.mark.parametrize("gamma", [0.0, 1.1, float("nan")])
    def test_invalid_discounts(self, gamma):
        with pytest.raises(upslope.UpslopeError, match="gamma is"):
            upslope.gymnax_tasks(Counting(), lambda key: Params(4), gamma)


class TestGymnax:
    def family(self, name, **changes):
        gymnax = pytest.importorskip("gymnax")
        env, _ = gymnax.make(name)
        return env, upslope.gymnax_tasks(env, lambda key: env.default_params.replace(**changes), 0.9)

    @pytest.mark.parametrize(
        ("name", "shape", "actions"),
        [
            ("CartPole-v1", (4,), 2),
            pytest.param("Acrobot-v1", (6,), 3, marks=pytest.mark.slow),
            pytest.param("MountainCar-v0", (2,), 3, marks=pytest.mark.slow),
            ("Breakout-MinAtar", (10, 10, 4), 3),
            pytest.param("FrozenLake-misc", (16,), 4, marks=pytest.mark.slow),
        ],
    )
    def test_true_successors_and_ends(self, name, shape, actions):
        """Each transition against gymnax's step without automatic reset."""
        env, family = self.family(name, max_steps_in_episode=30)
        assert (family.observation_shape, family.actions.count, family.max_steps) == (shape, actions, 30)
        params = family.sample(KEY)

        @jax.jit
        def play(key):
            def one(carry, key):
                obs, state = carry
                act_key, key = jax.random.split(key)
                action = jax.random.randint(act_key, (), 0, actions)
                shown, following, reward, terminated, truncated, info = family.env.step(key, state, action, params)
                plain = env.step_env(jax.random.split(key)[0], state, action, params)
                row = (obs, shown, reward, terminated, truncated, info["final_observation"])
                return (shown, following), (row, (family.env._fit(plain[0]), plain[2], plain[3], plain[1].time))

            return jax.lax.scan(one, family.env.reset(key, params), jax.random.split(key, 90))[1]

        (obs, shown, reward, terminated, truncated, final), (true, raw, ended, time) = play(KEY)
        np.testing.assert_array_equal(final, true)
        np.testing.assert_array_equal(reward, np.asarray(raw, np.float32))
        np.testing.assert_array_equal(terminated, ended)
        np.testing.assert_array_equal(truncated, (time >= 30) & ~np.asarray(ended))
        np.testing.assert_array_equal(obs[1:], shown[:-1])
        done = np.asarray(terminated | truncated)
        assert done.any()
        np.testing.assert_array_equal(np.asarray(shown)[~done], np.asarray(final)[~done])
        assert terminated.any() or truncated.any()

    @pytest.mark.slow
    def test_time_limits_and_failures_are_distinguished(self):
        _, car = self.family("MountainCar-v0")
        batch = rollout(car, randomly(3), 450)
        np.testing.assert_allclose(
            batch.discount, 0.9
        )  # random actions never reach the top, so only time limits end episodes
        assert np.all(np.asarray(batch.next_obs[:, 199]) != np.asarray(batch.obs[:, 200]))
        _, pole = self.family("CartPole-v1")
        ends = np.asarray(rollout(pole, randomly(2), 450).discount) == 0
        assert 10 < ends.sum() < 100

    def test_continuous_actions_with_bounds_that_differ_by_task(self):
        env, _ = self.family("Pendulum-v1")

        def torques(key):
            return env.default_params.replace(max_torque=jax.random.uniform(key, minval=1.0, maxval=9.0))

        family = upslope.gymnax_tasks(env, torques, 0.9)
        tasks = family.sample_many(KEY, 3)
        _, state = jax.vmap(family.env.reset)(jax.random.split(KEY, 3), tasks)
        after = jax.vmap(lambda s, p: family.env.step(KEY, s, jnp.ones(1), p)[1])(state, tasks)
        np.testing.assert_allclose(after.last_u, tasks.max_torque)

    @pytest.mark.slow
    def test_algorithm_1_runs_on_link_lengths(self):
        env, _ = self.family("Acrobot-v1")

        def links(key):
            length = jax.random.uniform(key, minval=0.5, maxval=1.5)
            return env.default_params.replace(link_length_1=length, link_com_pos_1=length / 2)

        learner = MetaTraining(upslope.gymnax_tasks(env, links, 0.95), SMALL)
        state = learner.init(KEY)
        state, metrics = jax.jit(learner.step)(state)
        assert np.isfinite(metrics["outer_loss"])
        np.testing.assert_array_equal(metrics["reward"], -1.0)


class TestXMiniGrid:
    @pytest.fixture(scope="class")
    @classmethod
    def family(cls):
        xminigrid = pytest.importorskip("xminigrid")
        from xminigrid.core.constants import Colors, Tiles
        from xminigrid.core.goals import AgentNearGoal
        from xminigrid.core.rules import EmptyRule
        from xminigrid.types import RuleSet

        env, params = xminigrid.make("XLand-MiniGrid-R1-9x9", max_steps=25)
        colours = jnp.array([Colors.RED, Colors.GREEN, Colors.BLUE])

        def rules(key):
            """One ball of each of two colours; the goal is to stand next to the first."""
            pair = jax.random.permutation(key, colours)[:2]
            balls = jnp.stack([jnp.full(2, Tiles.BALL), pair], axis=1).astype(jnp.uint8)
            goal = AgentNearGoal(tile=balls[0]).encode()
            return params.replace(ruleset=RuleSet(goal, EmptyRule().encode()[None], balls))

        return upslope.gymnax_tasks(TimeStepEnvironment(env), rules, 0.95)

    @pytest.mark.slow
    def test_tasks_end_at_their_goal_or_time_limit(self, family):
        assert (family.observation_shape, family.actions.count, family.max_steps) == ((5, 5, 2), 6, 25)
        batch = rollout(family, randomly(6), 200, tasks=8)
        reward, discount = np.asarray(batch.reward), np.asarray(batch.discount)
        np.testing.assert_array_equal(reward > 0, discount == 0)
        assert np.sum(discount == 0) > 5
        stays = np.all(np.asarray(batch.next_obs)[:, :-1] == np.asarray(batch.obs)[:, 1:], axis=(2, 3, 4))
        truncations = 0
        for row in range(8):
            time = 0
            for step in range(199):
                time += 1
                if discount[row, step] == 0 or time == 25:
                    truncations += discount[row, step] > 0
                    time = 0
                else:
                    assert stays[row, step], "only an end moves the agent elsewhere"
        assert truncations > 5

    def test_tasks_differ(self, family):
        goals = np.asarray(family.sample_many(KEY, 20).ruleset.goal)
        assert len(np.unique(goals, axis=0)) == 3

    @pytest.mark.slow
    def test_algorithm_1_runs_on_rules(self, family):
        learner = MetaTraining(family, SMALL)
        state, metrics = jax.jit(learner.step)(learner.init(KEY))
        assert isinstance(state.theta.torso, ConvolutionalTorso)
        assert np.isfinite(metrics["outer_loss"])
