"""Images of host environments: kept as images, learned by convolutions, and evaluated equally in plain numpy."""

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.spaces import Box

import upslope
from support import host
from upslope import GymnasiumTasks, UpslopeError
from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.learners.ddpg import DDPG, DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.networks.actor_critic import Actor, Critic
from upslope.networks.convolutional import ConvolutionalTorso
from upslope.networks.dueling import DuelingQ
from upslope.networks.mlp import numpy_layer
from upslope.networks.numpy_acting import affine
from upslope.networks.q_network import QNetwork
from upslope.priors.prior import Prior, trained_on
from upslope.run.loop import broadcast, run

SPACE = Box(0, 255, (5, 6, 3), np.uint8)
SCALE = (1 / 255,) * 3
IMAGES = np.random.default_rng(0).integers(0, 256, (7, *SPACE.shape)).astype(np.uint8)
KEY = jax.random.key(0)
DQN_SMALL = DQNConfig(hidden=(8,), batch_size=4, warmup_steps=8, replay_capacity=16, evaluation_episodes=1)


def dueling(activation="relu"):
    return DuelingQ(KEY, SPACE.shape, 3, (16, 8), SCALE, activation)


def lamps(space=SPACE):
    return GymnasiumTasks(lambda rng: 1.0, lambda task: host.Lamp(task, space), 0.9, max_steps=3)


@pytest.fixture(scope="module")
def family():
    return lamps()


def image_prior(family, activation="relu"):
    network = dueling(activation)
    return Prior(network, trained_on(family, network, 0, {}))


class TestFamily:
    def test_images_stay_images(self, family):
        assert family.observation_shape == (5, 6, 3)
        assert family.observation_scale == SCALE
        tasks = family.sample_many(KEY, 2)
        batch = family.rollout(KEY, tasks, lambda key, obs: jnp.zeros(len(obs), int), 4)
        assert batch.obs.shape == (2, 4, 5, 6, 3)
        assert 100 < float(batch.obs.max()) <= 255
        np.testing.assert_array_equal(batch.next_obs[:, :2], batch.obs[:, 1:3])
        assert np.all(np.any(np.asarray(batch.next_obs[:, 2] != batch.obs[:, 3]), axis=(1, 2, 3))), "no reset leaks"

    def test_each_channel_has_its_own_scale(self):
        high = np.broadcast_to(np.array([1.0, 10.0, 1e4], np.float32), (4, 4, 3))
        assert lamps(Box(-high, high)).observation_scale == pytest.approx((1.0, 0.1, 1.0))

    def test_large_images_are_refused(self):
        with pytest.raises(UpslopeError, match=r"210 × 160 pixels are too large.*ResizeObservation"):
            lamps(Box(0, 255, (210, 160, 3), np.uint8))

    def test_channels_that_come_first_are_refused(self):
        with pytest.raises(UpslopeError, match=r"\(3, 32, 32\) seem to have their channels first.*moveaxis"):
            lamps(Box(0, 255, (3, 32, 32), np.uint8))


class TestNumpy:
    @pytest.mark.parametrize(
        "network",
        [
            dueling(),
            dueling("tanh"),
            QNetwork(KEY, SPACE.shape, 3, (8,), SCALE),
            Actor(KEY, SPACE.shape, 3, (8,), SCALE),
        ],
    )
    def test_networks_choose_the_same_actions_as_in_jax(self, network):
        images = IMAGES.astype(np.float32)
        expected = np.asarray(jax.vmap(network.best)(jnp.asarray(images)))
        np.testing.assert_allclose(network.numpy_best()(images), expected, rtol=1e-5, atol=1e-6)

    @pytest.mark.parametrize("activation", ["relu", "tanh"])
    def test_scores_are_equal_to_jax(self, activation):
        images, network = IMAGES.astype(np.float32), dueling(activation)
        outputs = np.dot(affine(numpy_layer(network.advantage_head)), network.torso.numpy_features()(images)).T
        expected = np.asarray(jax.vmap(network.heads)(jnp.asarray(images))[1])
        np.testing.assert_allclose(outputs, expected, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(np.argsort(outputs), np.argsort(expected))

    @pytest.mark.parametrize("activation", ["relu", "tanh"])
    def test_potentials_are_equal_to_jax_in_double_precision(self, family, activation, tmp_path):
        prior = image_prior(family, activation)
        with jax.enable_x64(True):
            exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), prior.network)
            expected = np.asarray(jax.vmap(exact.value)(jnp.asarray(IMAGES, jnp.float64)))
        potential = prior.to_numpy()
        np.testing.assert_allclose(potential.values(IMAGES), expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose([potential(image) for image in IMAGES], expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(potential.values(IMAGES), prior.values(jnp.asarray(IMAGES, jnp.float32)), atol=1e-6)
        prior.save(tmp_path / "images.safetensors")
        assert upslope.NumpyPotential.load(tmp_path / "images.safetensors") == potential

    def test_a_prior_on_images_shapes(self, family):
        prior = image_prior(family)
        env = upslope.PotentialShaping(host.Lamp(1.0, SPACE), prior, gamma=0.9)
        obs, _ = env.reset(seed=0)
        following, reward, *_ = env.step(0)
        phi = prior.values(jnp.asarray(np.stack([obs, following]), jnp.float32))
        assert reward == pytest.approx(1.0 + 0.9 * float(phi[1]) - float(phi[0]), abs=1e-5)
        assert upslope.check_shaping(env, prior, 0.9, steps=100).ok
        flat = gym.wrappers.FlattenObservation(host.Lamp(1.0, SPACE))
        with pytest.raises(UpslopeError, match=r"shape \(5, 6, 3\), but the environment's"):
            upslope.PotentialShaping(flat, prior, gamma=0.9)


class TestLearners:
    @pytest.mark.slow
    def test_dqn_with_convolutions(self, family):
        learners = broadcast(DQN(family, family.sample(KEY), None, DQN_SMALL), (1,))
        outcome = run(learners, KEY[None], updates=2, every=2)
        assert isinstance(outcome.states.network.torso, ConvolutionalTorso)
        assert np.all(outcome.metrics["td_loss"][0, 1:] > 0)
        np.testing.assert_array_equal(outcome.reports["return"], 3.0)

    @pytest.mark.slow
    def test_algorithms_1_and_2(self, family):
        config = MetaTrainingConfig(
            iterations=2, tasks=2, steps_per_task=6, hidden=(8,), outer_updates=1, snapshot_every=2,
            evaluation_tasks=1, evaluation_episodes=1, posterior=NetworkPosterior(batch_size=4),
        )  # fmt: skip
        prior = upslope.meta_train(family, config=config)
        assert isinstance(prior.network.torso, ConvolutionalTorso)
        small = AdaptationConfig(batch_size=4, steps_per_update=4, evaluation_episodes=1, replay_capacity=16)
        result = upslope.adapt(family, family.sample(KEY), prior, updates=2, config=small)
        np.testing.assert_array_equal(result.returns, 3.0)
        assert result.posterior.to_numpy() != prior.to_numpy()

    @pytest.mark.slow
    def test_ddpg_with_convolutions(self):
        pushed = GymnasiumTasks(
            lambda rng: 1.0, lambda task: host.Lamp(task, SPACE, Box(-1, 1, (1,))), 0.9, max_steps=3
        )
        config = DDPGConfig(hidden=(8,), batch_size=4, warmup_steps=8, replay_capacity=16, evaluation_episodes=1)
        learners = broadcast(DDPG(pushed, pushed.sample(KEY), None, config), (1,))
        outcome = run(learners, KEY[None], updates=2, every=2)
        assert isinstance(outcome.states.actor.torso, ConvolutionalTorso)
        assert isinstance(outcome.states.critic.seeing, ConvolutionalTorso)
        np.testing.assert_array_equal(outcome.reports["return"], 3.0)


def test_a_critic_of_images_depends_on_images_and_actions():
    critic = Critic(KEY, SPACE.shape, 2, (8,), SCALE)
    first, second = (jnp.asarray(image, jnp.float32) for image in IMAGES[:2])
    action = jnp.array([0.5, -0.5])
    features = jnp.concatenate([critic.seeing(first), action])
    assert float(critic(first, action)) == pytest.approx(float(critic.head(critic.torso(features))[0]), rel=1e-6)
    assert float(critic(first, action)) != float(critic(second, action))
    assert float(critic(first, action)) != float(critic(first, -action))
