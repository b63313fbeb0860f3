"""The networks of learners on continuous actions."""

import jax
import jax.numpy as jnp
import numpy as np

from upslope.networks.actor_critic import Actor, Critic

SCALE = (0.5, 2.0, 10.0)
OBS = jnp.array([1.0, -2.0, 0.3])


def test_one_observation_gives_one_number_per_action():
    actor = Actor(jax.random.key(0), 3, 4, (6, 5), SCALE)
    assert actor.best(OBS).shape == (4,)
    assert actor.actions == 4


def test_critic_takes_observation_and_action_to_one_number():
    critic = Critic(jax.random.key(0), 3, 2, (6, 5), SCALE)
    assert critic(OBS, jnp.array([0.1, 0.2])).shape == ()
    assert critic.torso.scale == (*SCALE, 1.0, 1.0), "actions come in [−1, 1] already"


def test_actor_is_bounded_and_tanh_of_its_pre_activation():
    actor = Actor(jax.random.key(0), 3, 4, (6, 5))
    action = actor.best(100 * OBS)
    assert np.abs(action).max() <= 1
    np.testing.assert_allclose(action, np.tanh(actor.pre_activation(100 * OBS)), rtol=1e-6)


def test_the_actor_in_numpy_gives_the_same_actions():
    actor = Actor(jax.random.key(0), 3, 4, (6, 5), SCALE)
    many = 3 * jax.random.normal(jax.random.key(9), (50, 3))
    np.testing.assert_allclose(actor.numpy_best()(np.asarray(many)), jax.vmap(actor.best)(many), rtol=1e-5, atol=1e-6)
