"""The losses of DQN and DDPG compared with numpy; target networks follow at their rate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import ACTIONS, OBSERVATIONS, random_batch
from support.comparing import assert_trees_close, largest
from support.probes import choices, discrete_family
from upslope.equations.losses import huber
from upslope.learners.ddpg import actor_loss, critic_loss
from upslope.learners.dqn import DQN, DQNConfig, adam, dqn_loss
from upslope.networks.actor_critic import Actor, Critic
from upslope.networks.q_network import QNetwork

SIZES = (OBSERVATIONS, ACTIONS, (6, 5))
BATCH = random_batch(1)
THRESHOLD = 0.5


def mean_huber(errors):
    """The square up to the threshold, its tangent beyond."""
    size = np.abs(errors)
    assert size.min() < THRESHOLD < size.max(), "both branches are looked at"
    return float(np.mean(np.where(size <= THRESHOLD, size**2, THRESHOLD**2 + 2 * THRESHOLD * (size - THRESHOLD))))


@eqx.filter_jit  # one program, not one for every array shape
def networks(kind, count):
    return [kind(key, *SIZES) for key in jax.random.split(jax.random.key(0), count)]


class TestHuber:
    @pytest.mark.parametrize(
        ("error", "expected", "slope"),
        [(0.0, 0, 0), (0.5, 0.25, 1), (-2.0, 4, -4), (3.0, 9 - 1, 4), (-5.0, 16, -4)],  # 2·(2·|x| − 2) beyond 2
    )
    def test_by_hand(self, error, expected, slope):
        value, gradient = jax.value_and_grad(huber)(jnp.asarray(error), 2.0)
        assert (float(value), float(gradient)) == (expected, slope)


class TestDQN:
    network, target = networks(QNetwork, 2)

    def test_the_target_network_bootstraps(self):
        q, next_q = (
            np.asarray(jax.vmap(net)(obs)) for net, obs in ((self.network, BATCH.obs), (self.target, BATCH.next_obs))
        )
        errors = np.asarray(BATCH.reward + BATCH.discount * next_q.max(-1) - q[np.arange(len(q)), BATCH.action])
        ours = dqn_loss(self.network, self.target, BATCH, THRESHOLD)
        assert float(ours) == pytest.approx(mean_huber(errors), rel=1e-5)

    def test_one_step_moves_the_target_network_by_its_rate(self):
        config = DQNConfig(hidden=(8,), batch_size=8, warmup_steps=8, replay_capacity=64, target_rate=0.25)
        agent = DQN(discrete_family(), choices(), None, config)

        def one_step(key):
            state = agent.init(key)
            return state, *agent.step(state)

        before, after, metrics = jax.jit(one_step)(jax.random.key(0))
        expected = jax.tree.map(lambda new, old: 0.25 * new + 0.75 * old, after.network, before.target)
        assert_trees_close(after.target, expected)
        assert largest(jax.tree.map(jnp.subtract, after.network, before.network)) > 1e-4
        assert int(after.experience.replay.added) == 9
        assert float(metrics["td_loss"]) > 0


class TestDDPG:
    actor, target_actor = networks(Actor, 2)
    critic, target_critic = networks(Critic, 2)
    batch = BATCH._replace(action=jax.random.uniform(jax.random.key(5), (8, ACTIONS), minval=-1))

    def test_the_critic_bootstraps_from_both_target_networks(self):
        errors = []
        for obs, action, reward, discount, next_obs in zip(*self.batch, strict=True):
            next_q = self.target_critic(next_obs, self.target_actor.best(next_obs))
            errors.append(float(reward + discount * next_q - self.critic(obs, action)))
        ours = critic_loss(self.critic, self.target_actor, self.target_critic, self.batch, THRESHOLD)
        assert float(ours) == pytest.approx(mean_huber(np.array(errors)), rel=1e-5)

    @pytest.mark.parametrize("penalty", [0.0, 0.5])
    def test_the_actor_climbs_the_critic_less_the_penalty(self, penalty):
        values = [float(self.critic(obs, self.actor.best(obs))) for obs in self.batch.obs]
        squares = [float(jnp.mean(self.actor.pre_activation(obs) ** 2)) for obs in self.batch.obs]
        ours = actor_loss(self.actor, self.critic, self.batch, penalty)
        assert float(ours) == pytest.approx(-np.mean(values) + penalty * np.mean(squares), rel=1e-4)


class TestAdam:
    def first_and_fifth_step(self, decay_updates):
        optimiser = adam(0.5, decay_updates)
        state, steps = optimiser.init(jnp.zeros(())), []
        for _ in range(5):
            change, state = optimiser.update(jnp.ones(()), state)
            steps.append(float(change))
        return steps[0], steps[4]

    def test_its_step_size_is_constant_by_default(self):
        assert self.first_and_fifth_step(0) == pytest.approx((-0.5, -0.5), rel=1e-3)

    def test_its_step_size_can_fall_linearly_to_zero(self):
        assert self.first_and_fifth_step(4) == pytest.approx((-0.5, 0.0), rel=1e-3)
