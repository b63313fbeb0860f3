"""Learners on probe environments with values computed by hand: the learned values must be right, not just better."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support import probes
from support.batches import small_network
from support.probes import GAMMA, PLACES, discrete_family, observe, table_potential
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig, Algorithm2
from upslope.adaptation.controls import CentredTD, FrozenPotential, OneOf
from upslope.adaptation.fine_tuning import FineTuning
from upslope.learners.ddpg import DDPG, DDPGConfig
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.shaping import not_policy_invariant, potential_based
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.priors.potentials import stack
from upslope.run.loop import broadcast, run

OBS = jax.vmap(observe)(jnp.arange(PLACES))
DQN_UPDATES = 400
DQN_CONFIG = DQNConfig(
    hidden=(16,), learning_rate=0.02, decay_updates=DQN_UPDATES, batch_size=32, replay_capacity=600,
    warmup_steps=64, epsilon=0.5, target_rate=0.1,
)  # fmt: skip


def train(learners, updates, every=None):
    """Runs learners stacked from a list, each from its own key."""
    keys = jax.random.split(jax.random.key(0), len(learners))
    return run(stack(learners), keys, updates=updates, every=every or updates)


def at_every_place(networks, function=lambda network, obs: network(obs)):
    """The outputs of stacked networks at each place ``[learners, places, ...]``."""
    return np.asarray(jax.vmap(lambda network: jax.vmap(lambda obs: function(network, obs))(OBS))(networks))


def assert_learned(learned, expected, tolerance=0.05):
    """Checks equality at the places that episodes visit."""
    expected = np.asarray(expected, float)
    visited = np.isfinite(expected)
    np.testing.assert_allclose(learned[visited], expected[visited], rtol=0, atol=tolerance)


@pytest.mark.slow
class TestDQN:
    @pytest.fixture(scope="class")
    @staticmethod
    def outcome():
        learners = [DQN(discrete_family(), task, None, DQN_CONFIG) for task, _, _ in probes.DISCRETE.values()]
        return train(learners, DQN_UPDATES, every=5)

    @pytest.mark.parametrize("name", probes.DISCRETE)
    def test_it_learns_q(self, outcome, name):
        index = list(probes.DISCRETE).index(name)
        assert_learned(at_every_place(outcome.states.network)[index], probes.DISCRETE[name][1])

    @pytest.mark.parametrize("name", [name for name, probe in probes.DISCRETE.items() if probe[2] is not None])
    def test_it_reports_the_raw_greedy_return(self, outcome, name):
        index = list(probes.DISCRETE).index(name)
        assert outcome.reports["return"][index, -1] == probes.DISCRETE[name][2]

    @pytest.mark.slow
    def test_a_single_learner_starts_as_it_does_in_a_batch(self, outcome):
        keys = jax.random.split(jax.random.key(0), len(probes.DISCRETE))
        for index in (0, 5):
            task = list(probes.DISCRETE.values())[index][0]
            learner = broadcast(DQN(discrete_family(), task, None, DQN_CONFIG), (1,))
            alone = run(learner, keys[index : index + 1], updates=10, every=5)
            for name, values in alone.metrics.items():
                np.testing.assert_allclose(outcome.metrics[name][index, :3], values[0], rtol=1e-3, atol=1e-5)


SHAPED = {
    # Φ(s') = 5 after the only step counts as zero: Q = 1 − Φ(s).
    "constant reward": (probes.constant_reward, potential_based(table_potential(2, 5)), [[-1, -1], [np.nan] * 2]),
    # Q = γ − 2 and 1 + 3
    "two steps": (probes.two_steps, potential_based(table_potential(2, -3)), [[GAMMA - 2] * 2, [4, 4]]),
    "choices": (probes.choices, potential_based(table_potential(1, -1)), [[-1, GAMMA - 1], [2, 0]]),
    # F = γ·2 − 2 in every step, truncated or not: Q = 5 − 2.
    "truncation only": (probes.truncation_only, potential_based(table_potential(2, 9)), [[3, 3], [np.nan] * 2]),
    # Φ = V*: the shaped Q is the advantage.
    "optimal potential": (probes.choices, potential_based(table_potential(GAMMA, 1)), [[-GAMMA, 0], [0, -2]]),
    # Φ(terminal) kept: Q = 1 + γ·5 − 2
    "not invariant": (
        probes.constant_reward, not_policy_invariant(table_potential(2, 5), GAMMA), [[3, 3], [np.nan] * 2],
    ),
}  # fmt: skip


class TestShapedDQN:
    @pytest.fixture(scope="class")
    @staticmethod
    def outcome():
        learners = [DQN(discrete_family(), task(), shaping, DQN_CONFIG) for task, shaping, _ in SHAPED.values()]
        return train(learners, DQN_UPDATES)

    @pytest.mark.parametrize("name", SHAPED)
    def test_it_learns_q_less_the_potential(self, outcome, name):
        assert_learned(at_every_place(outcome.states.network)[list(SHAPED).index(name)], SHAPED[name][2], 0.1)

    def test_reported_returns_are_never_shaped(self, outcome):
        assert outcome.reports["return"][:, -1].tolist() == [1, 1, 1, 3, 1, 1]


@pytest.mark.slow
class TestDDPG:
    """−(a − target)² in one step: the actor must find the target, and the critic −Φ there."""

    targets = np.array([[0.5, 0.5], [0.5, -0.4], [0.5, -0.4]])
    potentials = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, -2.0]])

    @pytest.fixture(scope="class")
    @staticmethod
    def outcome():
        config = DDPGConfig(
            hidden=(64, 64), learning_rate=5e-3, decay_updates=1000, noise=0.6, saturation_penalty=0.01,
            evaluation_episodes=8, replay_capacity=1200,
        )  # fmt: skip
        learners = [
            DDPG(
                probes.continuous_family(),
                probes.TargetTask(jnp.asarray(targets, jnp.float32)),
                potential_based(table_potential(*potential)),
                config,
            )
            for targets, potential in zip(TestDDPG.targets, TestDDPG.potentials, strict=True)
        ]
        return train(learners, 1000)

    def test_the_actor_finds_the_target_of_each_observation(self, outcome):
        np.testing.assert_allclose(
            at_every_place(outcome.states.actor, lambda actor, obs: actor.best(obs))[..., 0], self.targets, atol=0.1
        )

    def test_the_critic_learns_the_value_less_the_potential(self, outcome):
        def value(networks, obs):
            actor, critic = networks
            return critic(obs, actor.best(obs))

        learned = at_every_place((outcome.states.actor, outcome.states.critic), value)
        np.testing.assert_allclose(learned, -self.potentials, atol=0.1)

    def test_reported_returns_are_raw(self, outcome):
        np.testing.assert_allclose(outcome.reports["return"][:, -1], 0, atol=0.02)


class TestMetaTraining:
    config = MetaTrainingConfig(
        iterations=300, averaging=0.9, tasks=3, steps_per_task=24, hidden=(16,), outer_step_size=0.02,
        epsilon=(0.5, 1.0), evaluation_tasks=4, evaluation_episodes=2,
        posterior=NetworkPosterior(batch_size=16, inner_step_size=0.05),
    )  # fmt: skip

    @pytest.fixture(scope="class")
    @staticmethod
    def outcome():
        learner = MetaTraining(discrete_family(), TestMetaTraining.config)
        return run(broadcast(learner, (1,)), jax.random.key(0)[None], updates=300, every=300)

    def test_the_value_head_learns_the_optimal_value(self, outcome):
        learned = at_every_place(outcome.states.average, lambda network, obs: network.value(obs))
        np.testing.assert_allclose(learned[0], [GAMMA, 1.0], atol=0.1)

    def test_q_of_the_best_actions_is_learned_too(self, outcome):
        assert_learned(at_every_place(outcome.states.average)[0], probes.DISCRETE["choices"][1], 0.1)

    def test_the_prior_acts_optimally_in_the_report(self, outcome):
        assert outcome.reports["return"][0, -1] == 1.0


PRIOR = small_network(3, inputs=PLACES, hidden=(16,))
PRIOR_VALUE, PRIOR_LEVEL = (
    np.asarray([function(obs) for obs in OBS])[:, None] for function in (PRIOR.value, PRIOR.highest_advantage)
)
Q = np.array(probes.DISCRETE["choices"][1])


RULES = {"Algorithm 2": Algorithm2(), "frozen": FrozenPotential(), "centred TD": CentredTD(), "MAML": FineTuning()}


class TestAdaptation:
    """Each update rule reaches the fixed point of its equations; one program runs them all."""

    @pytest.fixture(scope="class")
    @staticmethod
    def outcome():
        config = AdaptationConfig(batch_size=32, replay_capacity=2000, steps_per_update=4, epsilon=0.5)
        learners = [
            Adaptation(
                discrete_family(), probes.choices(), PRIOR, jnp.asarray(0.1),
                OneOf(tuple(RULES.values()), jnp.asarray(index)), config,
            )
            for index in range(len(RULES))
        ]  # fmt: skip
        return train(learners, 500)

    @pytest.fixture
    @staticmethod
    def heads(outcome, request):
        """V ``[places, 1]`` and A ``[places, actions]`` of the requested rule."""
        index = list(RULES).index(request.param)
        phi = jax.tree.map(lambda leaf: leaf[index : index + 1], outcome.states.phi)
        value, advantage = (at_every_place(phi, lambda net, obs, i=i: net.heads(obs)[i])[0] for i in (0, 1))
        return value[:, None], advantage

    @pytest.mark.parametrize("heads", ["Algorithm 2"], indirect=True)
    def test_equations_8_and_9_reach_the_advantage_and_the_optimal_value(self, heads):
        value, advantage = heads
        best = Q.max(-1, keepdims=True)
        np.testing.assert_allclose(value, best, atol=0.05)
        np.testing.assert_allclose(advantage - PRIOR_LEVEL, Q - best, atol=0.05)

    @pytest.mark.parametrize("heads", ["frozen"], indirect=True)
    def test_with_a_frozen_potential_a_learns_q_of_the_shaped_task(self, heads):
        np.testing.assert_allclose(heads[1] - PRIOR_LEVEL, Q - PRIOR_VALUE, atol=0.05)  # Eq. 1 with Φ = V_θ

    @pytest.mark.parametrize("heads", ["centred TD"], indirect=True)
    def test_centred_td_learns_q(self, heads):
        value, advantage = heads
        np.testing.assert_allclose(value + advantage - PRIOR_LEVEL, Q, atol=0.05)

    @pytest.mark.parametrize("heads", ["MAML"], indirect=True)
    def test_fine_tuning_learns_q_by_equation_6(self, heads):
        value, advantage = heads
        np.testing.assert_allclose(value + advantage - advantage.max(-1, keepdims=True), Q, atol=0.05)

    def test_all_final_policies_are_optimal(self, outcome):
        np.testing.assert_array_equal(outcome.reports["return"][:, -1], 1.0)

    def test_all_start_from_the_prior(self, outcome):
        assert len(set(outcome.reports["return"][:, 0].tolist())) == 1
