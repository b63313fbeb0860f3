"""Def. 2.1 and Eqs. 1, 4 to 9, against values computed by hand; gradients where an equation defines their flow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.batches import one_number as n
from upslope.equations import losses
from upslope.equations.shaping import shaped_optimum, shaping_reward

LEFT, RIGHT = jnp.asarray(0), jnp.asarray(1)

# JAX flushes subnormal numbers to zero.
reasonable = st.floats(-1e4, 1e4, width=32, allow_subnormal=False)
heads = st.tuples(reasonable, st.lists(reasonable, min_size=4, max_size=4))


def q_row(value, advantage):
    """Q(s, ·) for a row of advantages."""
    return losses.dueling_q(value, advantage, jnp.max(advantage))


class TestShaping:
    @pytest.mark.parametrize(
        ("discount", "expected"),
        [
            (0.9, 0.9 * 5 - 2),  # an ordinary step: γΦ(s') − Φ(s) = 4.5 − 2
            (0.0, -2.0),  # terminated: Φ(s') counts as zero, −Φ(s) is still paid
        ],
    )
    def test_definition_2_1(self, discount, expected):
        assert shaping_reward(2.0, discount, 5.0) == pytest.approx(expected)
        for library in (np, jnp):
            f = shaping_reward(library.array([2.0, 2.0]), discount, library.array([5.0, 5.0]))
            assert isinstance(f, type(library.zeros(1)))
            np.testing.assert_allclose(f, expected, rtol=1e-6)

    def test_equation_1_for_values(self):
        np.testing.assert_allclose(shaped_optimum(jnp.array([10.0, 7.0]), jnp.array([3.0, 9.0])), [7.0, -2.0])

    def test_equation_1_for_action_values(self):
        # Two states of three actions; Φ = 3 and 9, subtracted from every action of its state.
        q = jnp.array([[10.0, 4.0, 3.0], [9.0, 0.0, 1.0]])
        shaped = shaped_optimum(q, jnp.array([[3.0], [9.0]]))
        np.testing.assert_allclose(shaped, [[7.0, 1.0, 0.0], [0.0, -9.0, -8.0]])


class TestEquation4:
    def test_value(self):
        assert float(losses.prior_error(n(3), n(5))) == 4.0  # (3 − 5)²

    def test_gradient_pulls_the_potential_towards_the_optimal_value(self):
        assert float(jax.grad(losses.prior_error)(n(3), n(5))) == -4.0  # 2·(3 − 5)


class TestEquation5:
    def loss(self, q, next_value, discount=0.9):
        return losses.td_loss(q, n(0.5), n(discount), next_value)

    def test_value(self):
        # δ = 0.5 + 0.9·3 − 2 = 1.2
        assert float(self.loss(n(2), n(3))) == pytest.approx(1.2**2)
        assert float(losses.td_error(n(2), n(0.5), n(0.9), n(3))) == pytest.approx(1.2)

    def test_termination_removes_the_bootstrap(self):
        assert float(self.loss(n(2), n(3), discount=0.0)) == pytest.approx((0.5 - 2) ** 2)

    def test_another_action_has_another_error(self):
        # δ = 0.5 + 2.7 − 1 = 2.2 for the left action
        assert float(self.loss(n(1), n(3))) == pytest.approx(2.2**2)

    def test_full_gradient_flows_through_both_sides(self):
        q, next_value = jax.grad(self.loss, (0, 1))(n(2), n(3))
        assert float(q) == pytest.approx(-2.4)  # −2δ
        assert float(next_value) == pytest.approx(2 * 1.2 * 0.9)  # 2δγ

    def test_it_reaches_only_the_best_next_action(self):
        gradient = jax.grad(lambda row: self.loss(n(2), jnp.max(row)))(jnp.array([3.0, -1.0]))
        np.testing.assert_allclose(gradient, [2 * 1.2 * 0.9, 0.0], rtol=1e-5)

    def test_semi_gradient_stops_at_the_target(self):
        # Q(s, ·) = (w, 2w) and Q(s', ·) = (3w, −w) at w = 1: δ = 0.5 + 2.7w − 2w for the right action.
        def loss(w, stop):
            next_value = jnp.max(jnp.stack([3 * w, -w]))
            return self.loss(jnp.stack([w, 2 * w])[RIGHT], jax.lax.stop_gradient(next_value) if stop else next_value)

        assert float(jax.grad(loss)(n(1), True)) == pytest.approx(2 * 1.2 * -2)
        assert float(jax.grad(loss)(n(1), False)) == pytest.approx(2 * 1.2 * (2.7 - 2))


class TestEquation6:
    def test_value(self):
        # max A = 4, so Q = 1.5 + (1, 4, 2) − 4
        np.testing.assert_allclose(q_row(n(1.5), jnp.array([1.0, 4.0, 2.0])), [-1.5, 1.5, -0.5])

    def test_it_differs_from_the_mean_of_common_dueling_networks(self):
        # With the mean 7/3 the best action's value would be 1.5 + 4 − 7/3 instead of V.
        assert float(jnp.max(q_row(n(1.5), jnp.array([1.0, 4.0, 2.0])))) == 1.5

    @given(heads)
    def test_value_is_exactly_the_best_action_value(self, row):
        value, advantage = row
        assert float(jnp.max(q_row(n(value), jnp.asarray(advantage)))) == value

    @given(heads)
    def test_best_action_is_the_advantage_head_s(self, row):
        value, advantage = row
        q = np.asarray(q_row(n(value), jnp.asarray(advantage)))
        assert q[int(np.argmax(advantage))] == q.max()

    def test_level_of_the_advantage_head_does_not_matter(self):
        advantage = jnp.array([1.0, 4.0, 2.0])
        np.testing.assert_allclose(q_row(n(1), advantage), q_row(n(1), advantage + 8))

    def test_gradient_reaches_the_taken_and_the_best_action(self):
        # ∂Q(s, 0)/∂A = e_0 − e_argmax, and ∂Q/∂V = 1
        value, advantage = jax.grad(lambda v, a: q_row(v, a)[0], (0, 1))(n(1.5), jnp.array([1.0, 4.0, 2.0]))
        assert float(value) == 1.0
        np.testing.assert_allclose(advantage, [1.0, -1.0, 0.0])


class TestEquation7:
    prior, posterior = jnp.array([1.0, 2.0]), jnp.array([4.0, -8.0])

    def loss(self, prior, posterior, action):
        return losses.prior_learning_loss(prior[action], posterior[action])

    def test_value_is_taken_at_the_action(self):
        assert float(self.loss(self.prior, self.posterior, LEFT)) == 9.0  # (1 − 4)²
        assert float(self.loss(self.prior, self.posterior, RIGHT)) == 100.0  # (2 + 8)²

    def test_arrays_are_handled_elementwise(self):
        np.testing.assert_array_equal(losses.prior_learning_loss(self.prior, self.posterior), [9.0, 100.0])

    def test_gradient_flows_into_prior_and_posterior_alike(self):
        gradients = jax.grad(self.loss, (0, 1))(self.prior, self.posterior, LEFT)
        np.testing.assert_allclose(gradients[0], [-6.0, 0.0])
        np.testing.assert_allclose(gradients[1], [6.0, 0.0])


class TestEquation8:
    def test_value(self):
        # R' = 0.25, A(s, a) = −2, max A(s', ·) = −1: δ = 0.25 + 0.5·(−1) − (−2) = 1.75
        loss = losses.advantage_loss(n(-2), n(0.25), n(0.5), n(-1))
        assert float(loss) == pytest.approx(1.75**2)


class TestEquation9:
    value, advantage = n(3.0), jnp.array([-1.0, 2.0])

    def loss(self, value, advantage):
        return losses.value_loss(value, jnp.max(advantage))

    def test_value(self):
        assert float(self.loss(self.value, self.advantage)) == 4.0  # (3 − (2 + 3))² = (max A)²

    def test_target_is_stopped_so_only_the_value_moves(self):
        value, advantage = jax.grad(self.loss, (0, 1))(self.value, self.advantage)
        assert float(value) == -4.0  # 2·(V − (max A + V)) = −2·max A: V rises where some advantage is positive
        np.testing.assert_array_equal(advantage, [0.0, 0.0])
