"""Eqs. 2 and 3 on quadratics with closed forms, and against finite differences."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.batches import one_number as n
from support.differences import assert_gradient
from upslope.equations import maml
from upslope.errors import UpslopeError


class Bowl(NamedTuple):
    """½·curvature·(φ − centre)², whose gradient step shrinks φ − centre by 1 − α·curvature."""

    curvature: jax.Array
    centre: jax.Array


def bowl_loss(phi, bowl):
    return 0.5 * bowl.curvature * (phi - bowl.centre) ** 2


def slope_loss(phi, bowl):
    """A linear loss, without curvature."""
    return bowl.curvature * phi


def bent_loss(params, data):
    """A loss with nonzero third derivatives, over a PyTree of parameters."""
    return jnp.mean((jnp.tanh(data @ params["in"]) @ params["out"] - jnp.sin(data[:, 0])) ** 2)


def of_posterior(loss):
    """MAML's own outer loss: the task's loss of φ."""
    return lambda theta, phi, data: loss(phi, data)


def adapting(loss, **settings):
    """Eq. 2 as a function of θ and one task's data."""
    return lambda theta, data: maml.adapt(loss, theta, data, **settings)


BOWL = Bowl(n(2.0), n(1.0))
TWO_BOWLS = Bowl(jnp.array([1.0, 2.0]), jnp.array([1.0, 5.0]))


def meta_gradient(inner_loss, theta, *, steps=1, first_order=False):
    """The meta-gradient for one bowl, with the bowl's loss as the outer loss."""
    one = jax.tree.map(lambda leaf: leaf[None], BOWL)

    adapt_to = adapting(inner_loss, step_size=0.1, steps=steps, first_order=first_order)
    return float(maml.meta_gradient(adapt_to, of_posterior(bowl_loss), n(theta), one)[1])


def test_descend_steps_every_leaf_against_its_gradient():
    params, gradient = {"a": n(1), "b": jnp.array([2.0, 3.0])}, {"a": n(10), "b": jnp.array([-10.0, 0.0])}
    moved = maml.descend(params, gradient, 0.1)
    assert float(moved["a"]) == 0.0
    np.testing.assert_allclose(moved["b"], [3.0, 3.0])


@pytest.mark.parametrize(("steps", "expected"), [(1, 1 + 2 * 0.8), (2, 1 + 2 * 0.64), (3, 1 + 2 * 0.512)])
def test_adapting_n_times(steps, expected):
    # φ − 1 shrinks by 1 − 0.1·2 = 0.8 in each step, from θ − 1 = 2.
    phi = maml.adapt(bowl_loss, n(3), BOWL, step_size=0.1, steps=steps)
    assert float(phi) == pytest.approx(expected)


@pytest.mark.parametrize("first_order", [False, True])
def test_first_order_finds_the_same_posterior(first_order):
    phi = maml.adapt(bowl_loss, n(3), BOWL, step_size=0.1, steps=2, first_order=first_order)
    assert float(phi) == pytest.approx(1 + 2 * 0.64)


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_full_and_first_order_meta_gradients_have_their_closed_forms(steps):
    # L(φ) = (φ − 1)² with φ − 1 = 0.8ᴺ·2. Full: dL/dφ·dφ/dθ = 2·0.8ᴺ·2·0.8ᴺ. First order replaces dφ/dθ by 1.
    shrunk = 0.8**steps
    assert meta_gradient(bowl_loss, 3.0, steps=steps) == pytest.approx(4 * shrunk * shrunk)
    assert meta_gradient(bowl_loss, 3.0, steps=steps, first_order=True) == pytest.approx(4 * shrunk)


def test_first_order_is_exact_where_the_inner_loss_has_no_curvature():
    # φ = θ − 0.1·2, so dφ/dθ = 1 either way: 2·(3 − 0.2 − 1) = 3.6.
    assert meta_gradient(slope_loss, 3.0) == pytest.approx(3.6)
    assert meta_gradient(slope_loss, 3.0, first_order=True) == pytest.approx(3.6)


def test_outer_step_over_two_tasks():
    # φ = 1 + 0.9·2 = 2.8 and 5 + 0.8·(−2) = 3.4; slopes 1·1.8·0.9 = 1.62 and 2·(−1.6)·0.8 = −2.56, their mean −0.47.
    adapt_to = adapting(bowl_loss, step_size=0.1)
    theta = maml.outer_step(adapt_to, of_posterior(bowl_loss), n(3), TWO_BOWLS, step_size=0.5)
    assert float(theta) == pytest.approx(3 + 0.5 * 0.47)


def test_first_order_outer_step_over_two_tasks():
    # Without the factors 0.9 and 0.8: slopes 1.8 and −3.2, their mean −0.7.
    adapt_to = adapting(bowl_loss, step_size=0.1, first_order=True)
    theta = maml.outer_step(adapt_to, of_posterior(bowl_loss), n(3), TWO_BOWLS, step_size=0.5)
    assert float(theta) == pytest.approx(3 + 0.5 * 0.7)


def test_the_distance_depends_on_theta_as_well():
    # φ = 2.8 and 3.4 from θ = 3, as above: (0.2² + 0.4²)/2 by the distance of θ and φ, as in Algorithm 1.
    loss = maml.meta_loss(adapting(bowl_loss, step_size=0.1), lambda theta, phi, _: (theta - phi) ** 2, n(3), TWO_BOWLS)
    assert float(loss) == pytest.approx((0.04 + 0.16) / 2, rel=1e-5)


def test_meta_loss_is_the_mean_over_tasks():
    # ½·1·1.8² = 1.62 and ½·2·1.6² = 2.56
    loss = maml.meta_loss(adapting(bowl_loss, step_size=0.1), of_posterior(bowl_loss), n(3), TWO_BOWLS)
    assert float(loss) == pytest.approx((1.62 + 2.56) / 2)


@pytest.mark.parametrize("steps", [1, 3])
def test_meta_gradient_equals_finite_differences(steps):
    with jax.enable_x64(True):
        keys = jax.random.split(jax.random.key(1), 3)
        theta = {"in": jax.random.normal(keys[0], (2, 3)), "out": jax.random.normal(keys[1], (3,))}
        data = jax.random.normal(keys[2], (2, 5, 2))  # two tasks of five points

        adapt_to = adapting(bent_loss, step_size=0.3, steps=steps)

        @jax.jit
        def objective(params):
            return maml.meta_loss(adapt_to, of_posterior(bent_loss), params, data)

        loss, gradient = maml.meta_gradient(adapt_to, of_posterior(bent_loss), theta, data)
        assert float(loss) == pytest.approx(float(objective(theta)), rel=1e-10)
        assert_gradient(objective, theta, gradient)
        stepped = maml.outer_step(adapt_to, of_posterior(bent_loss), theta, data, step_size=0.7)
        np.testing.assert_allclose(stepped["in"], theta["in"] - 0.7 * gradient["in"], rtol=1e-10)


def test_in_sequence_it_is_the_mean_loss_and_its_gradient():
    keys = jax.random.split(jax.random.key(1), 3)
    theta = {"in": jax.random.normal(keys[0], (2, 3)), "out": jax.random.normal(keys[1], (3,))}
    data = jax.random.normal(keys[2], (4, 5, 2))  # four tasks of five points

    def one(params, batch):
        return bent_loss(maml.adapt(bent_loss, params, batch, step_size=0.3), batch)

    adapt_to = adapting(bent_loss, step_size=0.3)
    side_by_side = jax.value_and_grad(lambda params: jnp.mean(jax.vmap(lambda batch: one(params, batch))(data)))
    expected_loss, expected = side_by_side(theta)
    for in_sequence in (True, False):
        loss, gradient = jax.jit(
            lambda params, how=in_sequence: maml.meta_gradient(
                adapt_to, of_posterior(bent_loss), params, data, in_sequence=how
            )
        )(theta)
        assert float(loss) == pytest.approx(float(expected_loss), rel=1e-5)
        for name in theta:
            np.testing.assert_allclose(gradient[name], expected[name], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("steps", [0, -1])
def test_adapting_takes_at_least_one_step(steps):
    with pytest.raises(UpslopeError, match=f"inner_steps is {steps}"):
        maml.adapt(bowl_loss, n(3), BOWL, step_size=0.1, steps=steps)
