"""CartPole: parity with Gymnasium's at every length, the ends of episodes, automatic reset, continuous actions."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from hypothesis import given
from hypothesis import strategies as st

from support.poles import gymnasium_trajectory, gymnasium_twin, our_trajectories, poles
from upslope.envs.cartpole import CartPole, CartPoleParams, CartPoleState

COUNT, STEPS = 24, 200
DEFAULT = jax.tree.map(jnp.asarray, CartPoleParams())
step = jax.jit(CartPole().step)
push = jax.jit(CartPole(continuous=True).step)


def state(position=0.0, velocity=0.0, angle=0.0, spin=0.0, time=0):
    return CartPoleState(jnp.array([position, velocity, angle, spin]), jnp.asarray(time, jnp.int32))


def one_step(start, action=1, seed=0):
    return step(jax.random.key(seed), start, jnp.asarray(action), DEFAULT)


def compare_with_gymnasium(twins, params, tolerance):
    """Random actions from random starts: the same states and the same last step."""
    rng = np.random.default_rng(0)
    starts, actions = rng.uniform(-0.05, 0.05, (COUNT, 4)), rng.integers(2, size=(COUNT, STEPS))
    trajectories = our_trajectories(params, jnp.asarray(starts), jnp.asarray(actions))
    ours, rewards, terminated, truncated = map(np.asarray, trajectories)
    assert np.all(rewards == 1.0)
    for index, twin in enumerate(twins):
        theirs = gymnasium_trajectory(twin, starts[index], actions[index])
        last = len(theirs) - 1
        np.testing.assert_allclose(ours[index, : last + 1], theirs, rtol=0, atol=tolerance)
        assert np.flatnonzero(terminated[index])[0] == last, "the same step ends the episode"
        assert not truncated[index, : last + 1].any()


class TestParityWithGymnasium:
    # Half of the lengths are drawn at random; the others include the bounds of the range.
    lengths = np.concatenate([[0.25, 5.0], np.random.default_rng(1).uniform(0.25, 5.0, COUNT - 2)])

    def test_at_gymnasium_s_own_parameters(self):
        params = poles(np.ones(COUNT), angle_limit=math.radians(12))
        compare_with_gymnasium([CartPoleEnv()] * COUNT, params, 1e-4)

    def test_at_every_length(self):
        twins = [gymnasium_twin(float(np.float32(length))) for length in self.lengths]
        compare_with_gymnasium(twins, poles(self.lengths), 1e-4)

    def test_at_every_length_in_float64(self):
        with jax.enable_x64(True):
            compare_with_gymnasium([gymnasium_twin(length) for length in self.lengths], poles(self.lengths), 1e-9)


class TestDerivedQuantities:
    def test_by_hand(self):
        pole = CartPoleParams(length=3.0)
        assert (pole.half_length, pole.pole_mass, pole.total_mass) == pytest.approx((1.5, 0.3, 1.3))

    @given(st.floats(0.25, 5.0))
    def test_they_follow_a_change_of_length(self, length):
        pole = dataclasses.replace(CartPoleParams(length=1.0), length=length)
        assert pole.half_length == length / 2
        assert pole.pole_mass == pytest.approx(0.1 * length)
        assert pole.total_mass == pytest.approx(1 + 0.1 * length)


#: 14.9° + 0.02 s · 2 rad/s is beyond 15°.
ALMOST_FALLEN = {"angle": math.radians(14.9), "spin": 2.0}


class TestEndsOfEpisodes:
    @pytest.mark.parametrize(
        ("start", "expected"),
        [
            pytest.param({"angle": math.radians(14.9)}, False, id="within 15 degrees"),
            pytest.param(ALMOST_FALLEN, True, id="fallen right"),
            pytest.param({"angle": -math.radians(14.9), "spin": -2.0}, True, id="fallen left"),
            pytest.param({"position": 2.39}, False, id="on the track"),
            pytest.param({"position": 2.39, "velocity": 1.0}, True, id="off the track, right"),
            pytest.param({"position": -2.39, "velocity": -1.0}, True, id="off the track, left"),
        ],
    )
    def test_termination(self, start, expected):
        _, _, reward, terminated, truncated, _ = one_step(state(**start))
        assert bool(terminated) is expected
        assert not truncated
        assert float(reward) == 1.0

    @pytest.mark.parametrize(("time", "expected"), [(198, False), (199, True)])
    def test_truncation_at_200_steps_is_not_termination(self, time, expected):
        _, _, _, terminated, truncated, _ = one_step(state(time=time))
        assert bool(truncated) is expected
        assert not terminated

    def test_both_at_once_is_termination(self):
        _, _, _, terminated, truncated, _ = one_step(state(**ALMOST_FALLEN, time=199))
        assert terminated
        assert not truncated


class TestAutomaticReset:
    @pytest.mark.parametrize("start", [ALMOST_FALLEN, {"angle": 0.2, "time": 199}], ids=["terminated", "truncated"])
    def test_the_true_successor_is_kept_next_to_the_reset_observation(self, start):
        obs, following, _, _, _, info = one_step(state(**start))
        # Euler: the angle moves by 0.02 s times the previous spin.
        assert float(info["final_observation"][2]) == pytest.approx(start["angle"] + 0.02 * start.get("spin", 0.0))
        assert np.abs(obs).max() <= 0.05
        assert int(following.time) == 0
        np.testing.assert_array_equal(following.physics, obs)

    def test_an_ordinary_step_continues_from_its_successor(self):
        obs, following, _, _, _, info = one_step(state(angle=0.1, time=7))
        np.testing.assert_array_equal(obs, info["final_observation"])
        np.testing.assert_array_equal(following.physics, obs)
        assert int(following.time) == 8

    def test_fresh_observations_differ_by_key(self):
        ended = state(**ALMOST_FALLEN)
        assert not np.array_equal(one_step(ended, seed=0)[0], one_step(ended, seed=1)[0])

    def test_reset_draws_every_coordinate_from_the_narrow_interval(self):
        keys = jax.random.split(jax.random.key(0), 500)
        obs, fresh = jax.vmap(CartPole().reset, in_axes=(0, None))(keys, DEFAULT)
        assert np.all(np.abs(obs) <= 0.05)
        np.testing.assert_allclose(obs.min(axis=0), -0.05, atol=2e-3)
        np.testing.assert_allclose(obs.max(axis=0), 0.05, atol=2e-3)
        assert np.all(fresh.time == 0)


class TestContinuousActions:
    start = state(0.1, -0.2, 0.05, 0.3)

    def successor(self, action):
        return push(jax.random.key(0), self.start, jnp.asarray([action], jnp.float32), DEFAULT)[-1]["final_observation"]

    @pytest.mark.parametrize(("action", "discrete"), [(-1.0, 0), (1.0, 1)])
    def test_full_pushes_are_the_discrete_actions(self, action, discrete):
        np.testing.assert_allclose(
            self.successor(action), one_step(self.start, discrete)[-1]["final_observation"], rtol=1e-6
        )

    @pytest.mark.parametrize("action", [1.5, 40.0])
    def test_forces_beyond_the_full_one_are_clipped(self, action):
        np.testing.assert_array_equal(self.successor(action), self.successor(1.0))
        np.testing.assert_array_equal(self.successor(-action), self.successor(-1.0))

    @pytest.mark.parametrize("share", [0.0, 0.25, -0.5])
    def test_magnitude_is_the_share_of_ten_newtons_and_sign_its_direction(self, share):
        twin = gymnasium_twin(1.0)
        twin.force_mag = 10 * abs(share)
        theirs = gymnasium_trajectory(twin, np.asarray(self.start.physics), [int(share > 0)])
        np.testing.assert_allclose(self.successor(share), theirs[0], rtol=1e-5)

    def test_the_number_of_actions(self):
        assert (CartPole().actions, CartPole(continuous=True).actions) == (2, 1)
