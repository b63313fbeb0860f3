"""The benchmarks' peers compute what upslope computes, so that comparing their speed is fair."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

torch = pytest.importorskip("torch", reason="the peers of the benchmarks are written in PyTorch")

from benchmarks.convolutional_step import INNER_STEP_SIZE, Sizes, network, transitions  # noqa: E402
from benchmarks.meta_gradient import upslope_step  # noqa: E402
from benchmarks.peers.careful_meta_training import CarefulMetaTraining  # noqa: E402
from benchmarks.peers.cleanrl_dqn import CleanDQN  # noqa: E402
from benchmarks.peers.numpy_cartpoles import CartPoles, greedy_returns, numpy_advantages, weights_of  # noqa: E402
from benchmarks.peers.plain_meta_training import Batch, PlainMetaTraining, outer_step_size  # noqa: E402
from benchmarks.peers.torch_meta_gradient import peer_steps, torch_weights  # noqa: E402
from benchmarks.peers.torch_networks import carry_over  # noqa: E402

from support.meta import outer_gradient  # noqa: E402
from upslope.envs.cartpole import CartPoleState  # noqa: E402
from upslope.learners.dqn import DQNConfig, adam, dqn_loss  # noqa: E402
from upslope.meta_training.algorithm1 import MetaTraining  # noqa: E402
from upslope.meta_training.config import MetaTrainingConfig  # noqa: E402
from upslope.meta_training.posteriors import NetworkPosterior  # noqa: E402
from upslope.meta_training.posteriors.network import TaskBatch  # noqa: E402
from upslope.networks.q_network import QNetwork  # noqa: E402
from upslope.tasks import cartpoles  # noqa: E402
from upslope.types import Transition  # noqa: E402

pytestmark = pytest.mark.slow

CONFIG = MetaTrainingConfig(
    tasks=3, steps_per_task=20, iterations=5, posterior=NetworkPosterior(batch_size=8, inner_step_size=0.1)
)
FAMILY = cartpoles()


@pytest.fixture
def state():
    """Algorithm 1's state with three networks that differ."""
    meta = MetaTraining(FAMILY, CONFIG)
    state = meta.init(jax.random.key(3))
    shift = lambda by: jax.tree.map(lambda leaf: leaf * (1 + by), state.theta)  # noqa: E731
    return replace(state, target=shift(0.1), average=shift(0.2))


def random_batch(shape, seed=0, terminal=True):
    rng = np.random.default_rng(seed)
    discount = 0.98 * (rng.random(shape) > (0.3 if terminal else 0.0))
    return Transition(
        rng.normal(size=(*shape, 4)).astype(np.float32),
        rng.integers(2, size=shape),
        rng.normal(size=shape).astype(np.float32),
        discount.astype(np.float32),
        rng.normal(size=(*shape, 4)).astype(np.float32),
    )


def ours(state, batch, config=CONFIG):
    meta = MetaTraining(FAMILY, config)
    batch = jax.tree.map(jnp.asarray, batch)
    samples = TaskBatch(batch, jax.vmap(jax.vmap(state.target.value))(batch.next_obs))
    loss, gradient = jax.jit(lambda theta: outer_gradient(meta, theta, samples))(state.theta)
    return float(loss), gradient


def peer_of(kind, state, config=CONFIG):
    peer = kind(config)
    for name in ("theta", "target", "average"):
        carry_over(getattr(state, name), getattr(peer, name))
    return peer


def torch_batches(kind, batch):
    columns = [torch.from_numpy(np.asarray(column)) for column in batch]
    if kind is CarefulMetaTraining:
        return Batch(*columns)
    return [Batch(*task) for task in zip(*columns, strict=True)]


def gradients_of(peer):
    return {name: weight.grad.numpy() for name, weight in peer.theta.named_parameters()}


@pytest.mark.parametrize("kind", [PlainMetaTraining, CarefulMetaTraining])
@pytest.mark.parametrize("inner_steps", [1, 3])
def test_the_outer_gradient_of_a_peer_is_ours(kind, inner_steps, state):
    config = CONFIG.with_posterior(inner_steps=inner_steps)
    batch = random_batch((3, 8))
    loss, gradient = ours(state, batch, config)
    peer = peer_of(kind, state, config)
    assert peer.outer_step(torch_batches(kind, batch)) == pytest.approx(loss, rel=1e-4)
    expected = weights_of(gradient)
    for name, found in gradients_of(peer).items():
        np.testing.assert_allclose(found, expected[name], rtol=1e-3, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("kind", [PlainMetaTraining, CarefulMetaTraining])
def test_three_outer_steps_of_a_peer_are_ours(kind, state):
    """Adam and the falling step size too."""
    theta = state.theta
    optimiser = CONFIG.optimiser().init(theta)
    peer = peer_of(kind, state)
    for seed in range(3):
        batch = random_batch((3, 8), seed)
        gradient = ours(replace(state, theta=theta), batch)[1]
        change, optimiser = CONFIG.optimiser().update(gradient, optimiser)
        theta = optax.apply_updates(theta, change)
        peer.outer_step(torch_batches(kind, batch))
    found = dict(peer.theta.named_parameters())
    for name, expected in weights_of(theta).items():
        np.testing.assert_allclose(found[name].detach(), expected, rtol=1e-3, atol=2e-5, err_msg=name)
    assert outer_step_size(CONFIG, 20) == pytest.approx(CONFIG.outer_step_size_end)


@pytest.mark.parametrize("kind", [PlainMetaTraining, CarefulMetaTraining])
def test_an_iteration_of_a_peer_averages_as_ours_does(kind):
    peer = kind(CONFIG)
    start = {name: weight.detach().clone() for name, weight in peer.theta.named_parameters()}
    peer.iterate(1)
    for name, weight in peer.theta.named_parameters():
        moved = (weight - start[name]).detach()
        assert moved.abs().max() > 1e-3
        for slow, rate in ((peer.target, 0.1), (peer.average, 0.03)):
            found = dict(slow.named_parameters())[name].detach() - start[name]
            np.testing.assert_allclose(found, rate * moved, atol=1e-6)


@pytest.mark.parametrize("kind", [PlainMetaTraining, CarefulMetaTraining])
def test_the_experience_of_a_peer_is_of_true_successors(kind):
    config = replace(CONFIG, epsilon=(1.0, 1.0), steps_per_task=200)
    peer = kind(config)
    replay = peer.collect(1.0, 1.0) if kind is PlainMetaTraining else [column[0] for column in peer.collect()]
    obs, _, reward, discount, following = (np.asarray(column) for column in replay)
    ended = discount == 0
    assert 3 < ended.sum() < 30, "a random policy falls after some 20 steps"
    np.testing.assert_array_equal(reward, 1)
    assert (np.abs(following[ended, 2]) > np.radians(15)).all()
    assert (np.abs(following[~ended, 2]) <= np.radians(15) + 1e-6).all()
    np.testing.assert_array_equal(obs[1:][~ended[:-1]], following[:-1][~ended[:-1]])


def test_numpy_cartpoles_are_ours():
    tasks = FAMILY.sample_many(jax.random.key(1), 5)
    poles = CartPoles(np.asarray(tasks.length), np.random.default_rng(0))
    running = jax.vmap(CartPoleState)(jnp.asarray(poles.physics), jnp.zeros(5, jnp.int32))
    for step in range(6):
        action = np.array([0, 1, 1, 0, 1]) ^ (step % 2)
        keys = jax.random.split(jax.random.key(step), 5)
        obs, running, _, terminated, _, _ = jax.vmap(FAMILY.env.step)(keys, running, jnp.asarray(action), tasks)
        found, ended, _ = poles.step(action)
        np.testing.assert_allclose(found, obs, rtol=1e-4, atol=1e-6)
        np.testing.assert_array_equal(ended, terminated)


def test_greedy_returns_of_a_policy_known_to_balance_and_of_one_that_falls():
    lengths = np.linspace(0.25, 5, 4)
    upright = lambda obs: np.stack([0 * obs[:, 2], obs[:, 2] + 0.3 * obs[:, 3]], axis=1)  # noqa: E731
    np.testing.assert_array_equal(greedy_returns(upright, lengths), 200)
    assert (greedy_returns(lambda obs: np.stack([obs[:, 2] * 0, obs[:, 2] * 0 + 1], axis=1), lengths) < 40).all()


def test_the_numpy_network_of_the_careful_peer(state):
    obs = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32)
    found = numpy_advantages(weights_of(state.theta))(obs)
    np.testing.assert_allclose(found, jax.vmap(state.theta.heads)(obs)[1], rtol=1e-4, atol=1e-5)


def test_the_loss_and_one_update_of_the_clean_dqn_are_ours():
    import gymnasium as gym

    config = DQNConfig(warmup_steps=10, decay_updates=100)
    network = QNetwork(jax.random.key(0), 4, 2, (32, 32), FAMILY.observation_scale)
    target = jax.tree.map(lambda leaf: leaf * 1.1, network)
    peer = CleanDQN(gym.make("upslope/CartPole-v0"), config)
    carry_over(network, peer.network)
    carry_over(target, peer.target)
    batch = random_batch((64,))
    batch = batch._replace(reward=10 * batch.reward)  # beyond the threshold of the Huber loss too
    loss, gradient = jax.value_and_grad(dqn_loss)(network, target, jax.tree.map(jnp.asarray, batch), 3.0)
    change, _ = adam(config.learning_rate, 100).update(gradient, adam(config.learning_rate, 100).init(network))
    network = optax.apply_updates(network, change)
    target = optax.incremental_update(network, target, config.target_rate)
    assert peer.update(*(torch.from_numpy(np.asarray(column)) for column in batch)) == pytest.approx(
        float(loss), rel=1e-5
    )
    for expected, found in ((network, peer.network), (target, peer.target)):
        for name, weight in weights_of(expected).items():
            np.testing.assert_allclose(found.state_dict()[name], weight, rtol=1e-3, atol=2e-5, err_msg=name)


@pytest.mark.parametrize("target", ["stopped", "kept"])
def test_the_convolutional_peers_outer_gradient_is_ours(target):
    sizes = Sizes(tasks=2, batch=3)
    loss, gradient = upslope_step(sizes, "rows", target)()
    batch = jax.tree.map(np.asarray, transitions(sizes))
    expected = torch_weights(gradient, batch.obs.shape[2:])
    for how, step in peer_steps(batch, network("rows"), INNER_STEP_SIZE).items():
        found_loss, found = step(target)
        assert found_loss == pytest.approx(float(loss), rel=1e-3), how
        for name, array in expected.items():
            scale = np.abs(array).max()
            np.testing.assert_allclose(found[name], array, rtol=1e-2, atol=1e-4 * scale, err_msg=f"{how}, {name}")
