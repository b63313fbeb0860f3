"""F of batches: truncation, termination, both, the unshaped baseline, the telescoping sum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upslope.learners.shaping import add_shaping, not_policy_invariant, potential_based
from upslope.types import Transition

GAMMA = 0.9
STEPS = 6


def level(obs):
    """Φ(s) is the first coordinate."""
    return obs[0]


def transitions(levels, next_levels, terminated):
    """Transitions with the given Φ(s) and Φ(s') and reward 1."""
    count = len(levels)

    def observations(first):
        return jnp.stack([jnp.asarray(first, jnp.float32), jnp.full(count, 99.0)], axis=1)

    discount = GAMMA * (1 - jnp.asarray(terminated, jnp.float32))
    return Transition(observations(levels), jnp.zeros(count, int), jnp.ones(count), discount, observations(next_levels))


#: An ordinary or truncated step (γ is kept, so they look the same), a terminated step, both at once (terminated).
HAND_MADE = transitions([2.0, 2.0, -1.0], [5.0, 5.0, 3.0], [False, True, True])
ORDINARY_OR_TRUNCATED, TERMINATED, BOTH = 0, 1, 2


@pytest.fixture(scope="module")
def added():
    return potential_based(level).rewards(HAND_MADE)


def test_truncation_keeps_the_successor_s_potential(added):
    assert float(added[ORDINARY_OR_TRUNCATED]) == pytest.approx(0.9 * 5 - 2)


def test_termination_counts_the_successor_s_potential_as_zero_and_subtracts_phi(added):
    assert float(added[TERMINATED]) == -2.0


def test_both_at_once_is_termination(added):
    assert float(added[BOTH]) == 1.0  # −Φ(s) = −(−1)


def test_shaped_rewards_are_raw_rewards_plus_f(added):
    shaped = add_shaping(HAND_MADE, added)
    np.testing.assert_allclose(shaped.reward, [1 + 2.5, 1 - 2, 1 + 1], rtol=1e-6)


def test_shaping_changes_nothing_but_the_reward(added):
    shaped = add_shaping(HAND_MADE, added)
    for name in ("obs", "action", "discount", "next_obs"):
        np.testing.assert_array_equal(getattr(shaped, name), getattr(HAND_MADE, name))


def test_the_unshaped_baseline_is_the_batch_itself():
    assert add_shaping(HAND_MADE, None) is HAND_MADE


def test_shaping_is_applied_at_all(added):
    assert np.all(np.abs(added) > 0.5), "a silent no-op would pass every smoke test"


class TestNotPolicyInvariant:
    def test_it_keeps_the_terminal_potential(self):
        added = not_policy_invariant(level, GAMMA).rewards(HAND_MADE)
        np.testing.assert_allclose(added, [0.9 * 5 - 2, 0.9 * 5 - 2, 0.9 * 3 + 1], rtol=1e-6)

    def test_it_shares_the_form_of_the_invariant_one(self):
        ours, theirs = potential_based(level), not_policy_invariant(level, GAMMA)
        assert jax.tree.structure(ours) == jax.tree.structure(theirs)


potentials = st.lists(st.floats(-100, 100, width=32), min_size=STEPS + 1, max_size=STEPS + 1)
all_at_once = jax.jit(lambda batch: potential_based(level).rewards(batch))


@given(potentials)
def test_discounted_sum_over_a_terminated_episode_is_minus_the_first_potential(levels):
    episode = transitions(levels[:-1], levels[1:], [False] * (STEPS - 1) + [True])
    total = np.sum(GAMMA ** np.arange(STEPS) * np.asarray(all_at_once(episode), float))
    assert total == pytest.approx(-levels[0], abs=1e-3)


@given(potentials)
def test_discounted_sum_over_a_truncated_episode_leaves_the_last_potential(levels):
    episode = transitions(levels[:-1], levels[1:], [False] * STEPS)
    total = np.sum(GAMMA ** np.arange(STEPS) * np.asarray(all_at_once(episode), float))
    assert total == pytest.approx(GAMMA**STEPS * levels[-1] - levels[0], abs=1e-3)


@given(potentials, st.floats(-10, 10))
def test_a_constant_potential_costs_a_little_on_ordinary_steps_and_itself_at_the_end(levels, constant):
    episode = transitions(levels[:-1], levels[1:], [False] * (STEPS - 1) + [True])
    added = jax.jit(lambda c, batch: potential_based(lambda _: c).rewards(batch))(jnp.asarray(constant), episode)
    np.testing.assert_allclose(added[:-1], (GAMMA - 1) * constant, atol=1e-5)
    np.testing.assert_allclose(added[-1], -constant, atol=1e-5)
