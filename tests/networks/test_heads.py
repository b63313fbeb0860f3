"""The discrete head's readings, by hand, and how a head is chosen."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.errors import UpslopeError
from upslope.networks.heads import DiscreteHead, head_class

HEAD = DiscreteHead(jnp.array([[1.0, 0.0], [0.0, 2.0], [-1.0, 1.0]]), jnp.array([0.5, 0.0, 0.0]))
OUTPUTS = np.array([[1.5, 4.0, 1.0], [2.0, -1.0, 3.0]])


def test_outputs_are_affine_in_the_features():
    np.testing.assert_array_equal(HEAD(jnp.array([1.0, 2.0])), [1.5, 4.0, 1.0])


@pytest.mark.parametrize("array", [np.asarray, jnp.asarray])
class TestReadings:
    """Of one state's outputs or many, in NumPy and JAX."""

    def test_one_action(self, array):
        assert float(HEAD.advantage(array(OUTPUTS[0]), 1)) == 4.0
        np.testing.assert_array_equal(HEAD.advantage(array(OUTPUTS), 0), [1.5, 2.0])

    def test_the_highest(self, array):
        assert float(HEAD.highest(array(OUTPUTS[0]))) == 4.0
        np.testing.assert_array_equal(HEAD.highest(array(OUTPUTS)), [4.0, 3.0])

    def test_q_by_equation_6(self, array):
        # Q = V + A − max A
        np.testing.assert_allclose(HEAD.each_q(array(10.0), array(OUTPUTS[0])), [7.5, 10.0, 7.0])
        values = array(np.array([10.0, 0.0]))
        np.testing.assert_allclose(HEAD.each_q(values, array(OUTPUTS)), [[7.5, 10.0, 7.0], [-1.0, -4.0, 0.0]])
        np.testing.assert_allclose(HEAD.q(values, array(OUTPUTS), 0), [7.5, -1.0])

    def test_the_best_action(self, array):
        assert int(HEAD.best(array(0.0), array(OUTPUTS[0]))) == 1
        np.testing.assert_array_equal(HEAD.best(array(np.zeros(2)), array(OUTPUTS)), [1, 2])


def test_random_actions_are_uniform():
    drawn = HEAD.random(jax.random.key(0), 20_000)
    np.testing.assert_allclose(np.bincount(drawn, minlength=3) / 20_000, 1 / 3, atol=0.014)


def test_a_fresh_head_has_one_output_for_each_action():
    head = DiscreteHead.fresh(jax.random.key(0), 5, 3)
    assert (head.weight.shape, head.bias.shape) == ((3, 5), (3,))
    assert head(jnp.ones(5)).shape == (3,)


class TestChoice:
    def test_the_head_for_discrete_actions(self):
        assert head_class(None, "discrete") is head_class("discrete", "discrete") is DiscreteHead

    @pytest.mark.parametrize(
        ("name", "kind"), [("other", "discrete"), ("discrete", "continuous"), (None, "continuous")]
    )
    def test_no_such_head(self, name, kind):
        with pytest.raises(UpslopeError, match=f"for {kind} actions .*discrete for discrete ones"):
            head_class(name, kind)
