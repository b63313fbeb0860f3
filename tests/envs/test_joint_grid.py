"""Continuous actions as a grid: which number is which combination of forces."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.envs.joint_grid import JointGrid


class Box:
    low, high, shape = np.array([-1.0, 0.0], np.float32), np.array([1.0, 4.0], np.float32), (2,)


@dataclass(frozen=True)
class Echo:
    """Shows the action that it was given."""

    name = "echo"

    def step(self, key, state, action, params):
        return action, state, 0.0, False, False, {}

    def action_space(self, params):
        return Box


def actions(bins):
    grid = JointGrid(Echo(), bins)
    numbers = jnp.arange(grid.action_space(None).n)
    return np.asarray(jax.vmap(lambda number: grid.step(jax.random.key(0), None, number, None)[0])(numbers))


def test_all_combinations_in_order():
    np.testing.assert_allclose(
        actions(3),
        [[-1, 0], [-1, 2], [-1, 4], [0, 0], [0, 2], [0, 4], [1, 0], [1, 2], [1, 4]],
    )


@pytest.mark.parametrize("bins", [2, 5])
def test_the_bounds_are_among_them(bins):
    found = actions(bins)
    assert len(found) == bins**2
    np.testing.assert_allclose([found.min(0), found.max(0)], [Box.low, Box.high])
