"""The verbs: any function of an observation is a potential, and one that is none is refused with its mend."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope import Prior, UpslopeError, cartpoles, train
from upslope.api import agent, check_potential
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import trained_on

POLES = cartpoles()
TASK = POLES.sample(jax.random.key(0))
SMALL = DQNConfig(batch_size=4, warmup_steps=8, replay_capacity=64, evaluation_episodes=1)


def prior_of(family=POLES) -> Prior:
    network = DuelingQ(jax.random.key(0), 4, 2, (8,), family.observation_scale)
    return Prior(network, trained_on(family, network, 0, {}))


@pytest.mark.parametrize(
    ("potential", "words"),
    [
        (lambda obs: obs, r"returned \(4,\) for one observation"),
        (lambda obs: obs[:1], r"returned \(1,\) for one observation"),
        (lambda obs: "high", "returned"),
        (lambda obs: jnp.log(obs[0]), "not finite at the zero observation"),
        (lambda obs: jnp.nan * obs[0], "not finite at the zero observation"),
        (lambda obs: obs[0] if obs[0] > 0 else 0.0, "failed on one observation"),
        (lambda obs: obs["angle"], "failed on one observation"),
    ],
)
def test_what_is_no_potential_is_refused(potential, words: str) -> None:
    with pytest.raises(UpslopeError, match=words):
        train(POLES, TASK, potential, config=SMALL)


def test_a_plain_function_and_a_bound_method_are_potentials() -> None:
    obs = jnp.array([0.1, 0.2, -0.3, 0.4])
    assert float(check_potential(lambda obs: -jnp.abs(obs[2]), POLES)(obs)) == pytest.approx(-0.3)
    network = prior_of().network
    assert float(check_potential(network.value, POLES)(obs)) == pytest.approx(float(network.value(obs)))


def test_training_reports_raw_returns_whatever_the_potential() -> None:
    """The first report comes before any update: the same networks and episodes, so the same returns."""
    raw = train(POLES, TASK, None, updates=4, every=2, config=SMALL)
    shaped = train(POLES, TASK, lambda obs: 100.0 * obs[0], updates=4, every=2, config=SMALL)
    np.testing.assert_array_equal(raw.updates, [0, 2, 4])
    assert raw.reports["return"][0, 0] == shaped.reports["return"][0, 0]
    assert raw.metrics["shaped_reward"][0, 1] == pytest.approx(1.0)
    assert shaped.metrics["shaped_reward"][0, 1] != pytest.approx(1.0)


def test_a_potential_that_is_not_finite_somewhere_stops_the_run() -> None:
    with pytest.raises(UpslopeError, match="not a finite number at update"):
        train(POLES, TASK, lambda obs: jnp.where(obs[2] == 0, 0.0, jnp.inf), updates=4, every=2, config=SMALL)


def test_a_prior_of_other_tasks_is_refused() -> None:
    with pytest.raises(UpslopeError, match=r"gamma is 0.98 in the prior and 0.9 in the tasks"):
        train(cartpoles(gamma=0.9), TASK, prior_of(), config=SMALL)


def test_settings_of_the_other_learner_are_refused() -> None:
    with pytest.raises(UpslopeError, match="use DQN"):
        agent(POLES, TASK, None, DDPGConfig())
    with pytest.raises(UpslopeError, match="use DDPG"):
        agent(cartpoles(continuous=True), TASK, None, SMALL)


def test_a_prior_is_its_value_head() -> None:
    prior = prior_of()
    obs = jnp.ones((3, 4)) * 0.1
    assert float(prior(obs[0])) == pytest.approx(float(prior.network.value(obs[0])))
    np.testing.assert_allclose(prior.values(obs), np.full(3, float(prior(obs[0]))), rtol=1e-6)
    assert prior.gamma == replace(prior.trained_on).gamma == 0.98
