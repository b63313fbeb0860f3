"""The registered CartPoles: Gymnasium's checker, rendering, and the same transitions as the compiled ones."""

import subprocess
import sys
import warnings

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import upslope
from support.poles import gymnasium_trajectory, gymnasium_twin
from upslope.envs.cartpole import CartPole, CartPoleState
from upslope.envs.registration import register_environments
from upslope.errors import UpslopeError
from upslope.tasks import cartpoles

NAMES = ["upslope/CartPole-v0", "upslope/ContinuousCartPole-v0"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("length", [0.25, 5.0])
def test_gymnasium_s_checker_passes_without_warnings(name, length, recwarn):
    env = gym.make(name, length=length, render_mode="rgb_array").unwrapped
    env.spec = gym.spec(name)
    check_env(env)
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("length", [0.25, 1.0, 3.0, 5.0])
def test_same_transitions_as_the_compiled_environment(name, length):
    host, compiled = gym.make(name, length=length), CartPole(continuous="Continuous" in name)
    params = cartpoles().sample_params.with_length(length)
    step = jax.jit(compiled.step)
    host.action_space.seed(0)
    ends = 0
    for episode in range(5):
        obs, _ = host.reset(seed=episode)
        state = CartPoleState(jnp.asarray(obs), jnp.zeros((), jnp.int32))
        for _ in range(60):
            action = host.action_space.sample()
            obs, reward, terminated, _, _ = host.step(action)
            _, following, ours, ended, _, info = step(jax.random.key(0), state, action, params)
            np.testing.assert_allclose(obs, info["final_observation"], rtol=1e-4, atol=1e-5)
            assert (reward, terminated) == (float(ours), bool(ended))
            ends += terminated
            if terminated:
                break
            state = following
    assert ends > 0 or length == 5.0


@pytest.mark.parametrize("length", [0.5, 2.0])
def test_same_trajectory_as_gymnasium_s_own_to_the_last_bit(length):
    env = gym.make("upslope/CartPole-v0", length=length)
    start, actions = [0.01, -0.02, 0.03, 0.04], np.random.default_rng(0).integers(0, 2, 200)
    expected = gymnasium_trajectory(gymnasium_twin(length), np.array(start), actions)
    env.reset(seed=0, options={"state": start})
    states = []
    for action in actions:
        terminated = env.step(action)[2]
        states.append(env.unwrapped._physics)
        if terminated:
            break
    np.testing.assert_allclose(states, expected, rtol=1e-12, atol=1e-13)


def test_truncated_at_200_steps_while_upright():
    env = gym.make("upslope/ContinuousCartPole-v0", length=3.0)
    obs, _ = env.reset(seed=0)
    for step in range(200):
        obs, _, terminated, truncated, _ = env.step(np.sign(obs[2:3] + 0.3 * obs[3:4]))
        assert not terminated
        assert truncated == (step == 199)


def test_make_vec_and_another_limit():
    envs = gym.make_vec("upslope/CartPole-v0", num_envs=3, length=2.0, max_episode_steps=4)
    envs.reset(seed=0)
    ends = [envs.step(np.array([0, 1, t % 2]))[3] for t in range(4)]
    np.testing.assert_array_equal(ends, [[False] * 3] * 3 + [[True] * 3])


def test_rendered_frames_show_the_pole_moving():
    env = gym.make("upslope/CartPole-v0", render_mode="rgb_array")
    env.reset(seed=0, options={"state": [0.0, 0.0, 0.0, 0.0]})
    upright = env.render()
    assert upright.shape == (400, 600, 3)
    assert upright.dtype == np.uint8
    tilted = env.unwrapped
    tilted.reset(options={"state": [1.0, 0.0, 0.2, 0.0]})
    darkness = [255 * 3 - picture.astype(int).sum(-1).mean(0) for picture in (upright, tilted.render())]
    middles = [np.average(np.arange(600), weights=columns) for columns in darkness]
    assert middles[0] == pytest.approx(300, abs=1)
    assert middles[1] > 310
    assert gym.make("upslope/CartPole-v0").unwrapped.render() is None


@pytest.mark.parametrize("settings", [{"length": 0.0}, {"length": float("nan")}, {"track_limit": -1.0}])
def test_invalid_poles(settings):
    with pytest.raises(upslope.UpslopeError, match="must be positive"):
        gym.make("upslope/CartPole-v0", **settings)


def test_registering_twice_does_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register_environments()


@pytest.mark.parametrize(("name", "action"), [(NAMES[0], 7), (NAMES[0], -1), (NAMES[1], np.array([np.nan]))])
def test_invalid_actions(name, action):
    env = gym.make(name, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    with pytest.raises(UpslopeError, match="is not an action of this environment"):
        env.step(action)


@pytest.mark.parametrize("state", [[1, 2], [0, 0, np.nan, 0], 3.0])
def test_invalid_states(state):
    with pytest.raises(UpslopeError, match="four numbers"):
        gym.make(NAMES[0]).reset(options={"state": state})


#: Runs in a separate process, so that a hanging worker fails the test and no other test has imported JAX.
PLAY = """
import sys
import gymnasium as gym
import upslope
if __name__ == "__main__":
    envs = gym.make_vec(sys.argv[1], num_envs=2, vectorization_mode="async")
    envs.reset(seed=0)
    for _ in range(300):
        envs.step(envs.action_space.sample())
    envs.close()
    env = upslope.PotentialShaping(gym.make("upslope/CartPole-v0"), str(upslope.prior_path("cartpole")), gamma=0.98)
    env.reset(seed=0)
    assert env.step(1)[1] != 1.0
    assert not {"jax", "equinox", "torch"} & set(sys.modules), "JAX was imported"
    print("played")
"""


@pytest.mark.parametrize("name", [*NAMES, "upslope/Grid-v0"])
def test_simulator_processes_need_no_jax(name, tmp_path):
    """Forked workers, which could inherit the locks of JAX's threads, keep running."""
    (tmp_path / "play.py").write_text(PLAY, encoding="utf-8")
    command = [sys.executable, str(tmp_path / "play.py"), name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.strip() == "played", done.stderr
