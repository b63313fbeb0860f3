"""Thm. 3.2 on tables: alternating Eqs. 8 and 9 solves the task and moves the potential to V*."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.mdps import FiniteMDP, random_mdp, solve
from upslope.equations.losses import advantage_loss, value_loss
from upslope.equations.maml import descend
from upslope.equations.shaping import shaping_reward

STATES, ACTIONS = 6, 3
STEP_SIZE = 0.05


class Tables:
    """Eqs. 8 and 9 in expectation over every transition of one MDP."""

    def __init__(self, mdp: FiniteMDP):
        self.chances, self.rewards = jnp.asarray(mdp.chances).ravel(), jnp.asarray(mdp.rewards).ravel()
        every = jnp.indices(mdp.chances.shape).reshape(3, -1)
        self.state, self.action, self.following = every
        self.discount = jnp.asarray(mdp.discount)[self.following]

    def shaped_rewards(self, value):
        """R + F by Def. 2.1, with the value table as the potential."""
        table = jax.lax.stop_gradient(value)
        return self.rewards + shaping_reward(table[self.state], self.discount, table[self.following])

    def advantage_objective(self, advantage, value):
        highest_next = jax.lax.stop_gradient(advantage).max(-1)[self.following]
        losses = jax.vmap(advantage_loss)(
            advantage[self.state, self.action], self.shaped_rewards(value), self.discount, highest_next
        )
        return jnp.sum(self.chances * losses)

    def value_objective(self, value, advantage):
        return jnp.sum(jax.vmap(value_loss)(value, advantage.max(-1)))

    def alternate(self, advantage, value, *, steps, move_value=True):
        """One step of Eq. 8, one of Eq. 9, ``steps`` times."""

        def pair(_, tables):
            advantage, value = tables
            advantage = descend(advantage, jax.grad(self.advantage_objective)(advantage, value), STEP_SIZE)
            if move_value:
                value = descend(value, jax.grad(self.value_objective)(value, advantage), STEP_SIZE)
            return advantage, value

        return jax.jit(lambda *start: jax.lax.fori_loop(0, steps, pair, start))(advantage, value)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=[0, 1])
def mdp(request):
    return random_mdp(request.param, states=STATES, actions=ACTIONS, gamma=0.9)


def start(seed=0):
    keys = jax.random.split(jax.random.key(seed))
    return jax.random.normal(keys[0], (STATES, ACTIONS)), jax.random.normal(keys[1], (STATES,))


def test_alternating_reaches_the_optimal_policy_and_the_optimal_value(mdp):
    optimum = solve(mdp)
    advantage, value = Tables(mdp).alternate(*start(), steps=6000)
    # V starts at random; only Eq. 9 can have moved it to V*.
    np.testing.assert_allclose(value[mdp.ordinary], optimum.v[mdp.ordinary], atol=1e-6)
    np.testing.assert_allclose(advantage[mdp.ordinary], (optimum.q - optimum.v[:, None])[mdp.ordinary], atol=1e-6)


def test_equation_8_alone_learns_q_of_the_shaped_task(mdp):
    optimum = solve(mdp)
    advantage, potential = start()
    advantage, value = Tables(mdp).alternate(advantage, potential, steps=6000, move_value=False)
    np.testing.assert_array_equal(value, potential)
    expected = optimum.q - np.asarray(potential)[:, None]  # Eq. 1 with Φ = the value table as it started
    np.testing.assert_allclose(advantage[mdp.ordinary], expected[mdp.ordinary], atol=1e-6)
