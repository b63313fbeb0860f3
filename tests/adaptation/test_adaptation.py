"""Algorithm 2's two steps and its controls: the identities that relate them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import random_batch, small_network
from support.comparing import assert_trees_close, assert_trees_identical, largest
from upslope.adaptation.algorithm2 import Algorithm2, advantage_step_loss, value_step_loss
from upslope.adaptation.controls import CentredTD, FrozenPotential, OneOf, centred_td_loss
from upslope.adaptation.fine_tuning import FineTuning, fine_tuning_loss
from upslope.equations.maml import descend

STEP_SIZE = 0.05
PRIOR, OTHER = small_network(0), small_network(1)
BATCH = random_batch(2, leading=(12,))
CENTRED, RAW = Algorithm2(centred=True), Algorithm2(centred=False)
LEVEL = CENTRED.level(PRIOR)


def raw(network, obs):
    """A(s, ·), one number for each action."""
    return network.heads(obs)[1]


def updated(rule, phi, prior=PRIOR, batch=BATCH):
    return rule.update(phi, prior, batch, jnp.asarray(STEP_SIZE))


def after_equation_8(phi, prior=PRIOR):
    gradient = jax.grad(advantage_step_loss)(phi, phi, BATCH, CENTRED.level(prior))
    return descend(phi, gradient, STEP_SIZE)


def mean_squared_td_error(q, next_q):
    """The textbook loss in numpy: the mean of (r + d·max Q(s', ·) − Q(s, a))²."""
    chosen = np.take_along_axis(np.asarray(q), np.asarray(BATCH.action)[:, None], 1)[:, 0]
    return float(np.mean((BATCH.reward + BATCH.discount * np.asarray(next_q).max(-1) - chosen) ** 2))


def mean_of_pull(network, errors, scores):
    """Mean over the batch of −2·δ·∇scores(s, a): the semi-gradient of a mean squared TD error, one sample at a time."""
    slopes = jax.vmap(lambda obs, action: jax.grad(lambda net: scores(net, obs)[action])(network))(
        BATCH.obs, BATCH.action
    )
    return jax.tree.map(lambda leaf: jnp.mean(jax.vmap(jnp.multiply)(-2 * errors, leaf), axis=0), slopes)


def td_errors(rewards, scores, next_scores):
    chosen = jnp.take_along_axis(scores, BATCH.action[:, None], 1)[:, 0]
    return rewards + BATCH.discount * next_scores.max(-1) - chosen


def test_the_batch_has_both_ordinary_and_terminal_transitions():
    assert 0 < np.count_nonzero(BATCH.discount) < len(BATCH.discount)


class TestCentring:
    def test_a_starts_as_q_minus_v(self):
        for obs in BATCH.obs:
            np.testing.assert_allclose(raw(PRIOR, obs) - LEVEL(obs), PRIOR(obs) - PRIOR.value(obs), atol=1e-6)

    def test_its_maximum_starts_at_exactly_zero(self):
        for obs in BATCH.obs:
            assert float(jnp.max(raw(PRIOR, obs) - LEVEL(obs))) == 0.0

    def test_the_raw_advantage_has_no_level(self):
        assert float(RAW.level(PRIOR)(BATCH.obs[0])) == 0.0

    def test_the_level_is_the_prior_s_and_stays_frozen(self):
        obs = BATCH.obs[0]
        assert float(LEVEL(obs)) == float(jnp.max(raw(PRIOR, obs))) != float(jnp.max(raw(OTHER, obs)))


class TestEquation8:
    def test_it_leaves_the_value_head_alone_and_moves_the_rest(self):
        gradient = jax.grad(advantage_step_loss)(OTHER, OTHER, BATCH, LEVEL)
        assert largest(gradient.value_head) == 0.0
        assert largest(gradient.advantage_head) > 1e-3
        assert largest(gradient.torso) > 1e-3

    def test_the_potential_is_a_constant_in_it(self):
        gradient = jax.grad(advantage_step_loss, argnums=1)(PRIOR, OTHER, BATCH, LEVEL)
        assert largest(gradient) == 0.0

    def test_shaped_td_error_of_a_is_the_unshaped_one_of_v_plus_a(self):
        # The identity of the appendix, for a φ far from the prior; Φ(s') and the bootstrap must share a mask.
        loss = advantage_step_loss(OTHER, OTHER, BATCH, RAW.level(PRIOR))
        value, advantage = jax.vmap(OTHER.heads)(BATCH.obs)
        next_value, next_advantage = jax.vmap(OTHER.heads)(BATCH.next_obs)
        expected = mean_squared_td_error(value[:, None] + advantage, next_value[:, None] + next_advantage)
        assert float(loss) == pytest.approx(expected, rel=1e-5)

    def test_its_gradient_is_that_of_q_learning_on_the_shaped_task(self):
        f = BATCH.discount * jax.vmap(OTHER.value)(BATCH.next_obs) - jax.vmap(OTHER.value)(BATCH.obs)
        centred = jax.vmap(lambda obs: raw(OTHER, obs) - LEVEL(obs))
        errors = td_errors(BATCH.reward + f, centred(BATCH.obs), centred(BATCH.next_obs))
        ours = jax.grad(advantage_step_loss)(OTHER, OTHER, BATCH, LEVEL)
        assert_trees_close(ours, mean_of_pull(OTHER, errors, raw), rtol=1e-4)

    def test_the_rewards_are_shaped_at_all(self):
        zero = jax.tree.map(jnp.zeros_like, PRIOR)
        assert (
            abs(float(advantage_step_loss(PRIOR, PRIOR, BATCH, LEVEL) - advantage_step_loss(PRIOR, zero, BATCH, LEVEL)))
            > 1e-3
        )


class TestEquation9:
    def test_centring_at_every_step_would_make_its_gradient_identically_zero(self):
        phi = after_equation_8(PRIOR)
        assert largest(jax.grad(value_step_loss)(phi, BATCH, CENTRED.level(phi))) == 0.0

    def test_centred_by_the_prior_it_is_zero_only_before_the_first_step(self):
        assert largest(jax.grad(value_step_loss)(PRIOR, BATCH, LEVEL)) == 0.0
        gradient = jax.grad(value_step_loss)(after_equation_8(PRIOR), BATCH, LEVEL)
        assert largest(gradient.value_head) > 1e-4

    def test_it_leaves_the_advantage_head_alone_and_moves_the_rest(self):
        gradient = jax.grad(value_step_loss)(OTHER, BATCH, LEVEL)
        assert largest(gradient.advantage_head) == 0.0
        assert largest(gradient.value_head) > 1e-3
        assert largest(gradient.torso) > 1e-3

    def test_value_is_the_mean_squared_best_advantage(self):
        best = [float(jnp.max(raw(OTHER, obs) - LEVEL(obs))) for obs in BATCH.obs]
        assert float(value_step_loss(OTHER, BATCH, LEVEL)) == pytest.approx(np.mean(np.square(best)), rel=1e-5)


class TestAlgorithm2:
    def test_one_update_is_equation_8_then_equation_9(self):
        between = after_equation_8(OTHER)
        expected = descend(between, jax.grad(value_step_loss)(between, BATCH, LEVEL), STEP_SIZE)
        assert_trees_close(updated(CENTRED, OTHER), expected)

    def test_the_second_step_is_proportional_to_its_step_size(self):
        tenth = updated(Algorithm2(centred=True, value_step=0.1), OTHER)
        between = after_equation_8(OTHER)
        shorter = descend(between, jax.grad(value_step_loss)(between, BATCH, LEVEL), 0.1 * STEP_SIZE)
        assert_trees_close(tenth, shorter)
        assert largest(jax.tree.map(jnp.subtract, tenth, updated(CENTRED, OTHER))) > 1e-3

    def test_the_current_potential_shapes_and_not_the_prior_s(self):
        shaped_by_prior = descend(OTHER, jax.grad(advantage_step_loss)(OTHER, PRIOR, BATCH, LEVEL), STEP_SIZE)
        moved = np.abs(shaped_by_prior.advantage_head.bias - updated(CENTRED, OTHER).advantage_head.bias)
        assert moved.max() > 1e-3

    def test_centring_matters(self):
        moved = np.abs(updated(CENTRED, PRIOR).value_head.bias - updated(RAW, PRIOR).value_head.bias)
        assert moved.max() > 1e-3

    def test_a_step_size_of_zero_changes_nothing(self):
        assert_trees_identical(CENTRED.update(OTHER, PRIOR, BATCH, jnp.zeros(())), OTHER)


class TestFrozenPotential:
    def test_the_value_head_never_changes(self):
        assert_trees_identical(updated(FrozenPotential(), OTHER).value_head, OTHER.value_head)

    def test_both_steps_are_shaped_by_the_prior(self):
        phi = OTHER
        for _ in range(2):
            phi = descend(phi, jax.grad(advantage_step_loss)(phi, PRIOR, BATCH, LEVEL), STEP_SIZE)
        assert_trees_close(updated(FrozenPotential(), OTHER), phi)


class TestFineTuning:
    def test_two_steps_are_two_single_updates(self):
        once = updated(FineTuning(), PRIOR)
        assert_trees_close(updated(FineTuning(steps=2), PRIOR), updated(FineTuning(), once))

    def test_loss_by_hand(self):
        expected = mean_squared_td_error(jax.vmap(OTHER)(BATCH.obs), jax.vmap(OTHER)(BATCH.next_obs))
        assert float(fine_tuning_loss(OTHER, BATCH)) == pytest.approx(expected, rel=1e-5)

    def test_its_gradient_is_that_of_q_learning(self):
        q, next_q = jax.vmap(OTHER)(BATCH.obs), jax.vmap(OTHER)(BATCH.next_obs)
        expected = mean_of_pull(OTHER, td_errors(BATCH.reward, q, next_q), lambda net, obs: net(obs))
        assert_trees_close(jax.grad(fine_tuning_loss)(OTHER, BATCH), expected, rtol=1e-4)

    def test_the_prior_has_no_effect(self):
        assert_trees_identical(updated(FineTuning(), OTHER), updated(FineTuning(), OTHER, prior=OTHER))


class TestWhereTheArmsMeet:
    """At φ = θ all arms have the same TD error; they differ in which parameters it changes."""

    losses = (
        lambda phi: advantage_step_loss(phi, PRIOR, BATCH, LEVEL),
        lambda phi: centred_td_loss(phi, PRIOR, BATCH),
        lambda phi: fine_tuning_loss(phi, BATCH),
    )

    def test_one_loss(self):
        shaped, centred, plain = (float(loss(PRIOR)) for loss in self.losses)
        assert shaped == pytest.approx(plain, rel=1e-5)
        assert centred == pytest.approx(plain, rel=1e-5)

    def test_centred_td_moves_the_advantage_head_as_equation_8_does(self):
        first = updated(CentredTD(), PRIOR).advantage_head
        assert_trees_close(first, after_equation_8(PRIOR).advantage_head)
        assert largest(jax.tree.map(jnp.subtract, first, PRIOR.advantage_head)) > 1e-4

    def test_centred_td_moves_the_value_head_as_fine_tuning_does(self):
        assert_trees_close(updated(CentredTD(), PRIOR).value_head, updated(FineTuning(), PRIOR).value_head)

    def test_centred_td_s_gradient_is_that_of_q_learning_on_v_plus_a(self):
        centred = jax.vmap(lambda obs: OTHER.value(obs) + raw(OTHER, obs) - LEVEL(obs))
        errors = td_errors(BATCH.reward, centred(BATCH.obs), centred(BATCH.next_obs))
        expected = mean_of_pull(OTHER, errors, lambda net, obs: net.value(obs) + raw(net, obs))
        assert_trees_close(jax.grad(centred_td_loss)(OTHER, PRIOR, BATCH), expected, rtol=1e-4)

    def test_fine_tuning_differs_on_the_advantage_head_by_the_running_maximum(self):
        # Of Q = V + A − max A only actions other than the best one reach the A head; its biases' gradients sum to zero.
        plain = jax.grad(self.losses[2])(PRIOR).advantage_head.bias
        centred = jax.grad(self.losses[1])(PRIOR).advantage_head.bias
        assert float(plain.sum()) == pytest.approx(0, abs=1e-6)
        assert abs(float(centred.sum())) > 1e-3

    def test_away_from_the_prior_shaped_a_equals_centred_td_with_its_own_potential(self):
        # Eq. 8 of A − m_θ shaped by V_φ is the TD error of V_φ + A_φ − m_θ: Φ(s') and the bootstrap share a mask.
        ours = advantage_step_loss(OTHER, OTHER, BATCH, LEVEL)
        assert float(ours) == pytest.approx(float(centred_td_loss(OTHER, PRIOR, BATCH)), rel=1e-5)


class TestOneOf:
    rules = (CENTRED, RAW, FrozenPotential(), CentredTD(), FineTuning(), FineTuning(steps=2))

    def test_it_updates_as_the_rule_of_its_number_does(self):
        update = jax.jit(lambda index: updated(OneOf(self.rules, index), OTHER))
        for index, rule in enumerate(self.rules):
            assert_trees_close(update(jnp.asarray(index)), updated(rule, OTHER))

    def test_no_two_rules_are_the_same(self):
        outcomes = {np.asarray(updated(rule, OTHER).torso.layers[0].weight).tobytes() for rule in self.rules}
        assert len(outcomes) == len(self.rules)
