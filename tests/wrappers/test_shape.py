"""`upslope.shape` returns the wrapper that fits the environment; all wrappers document the same settings."""

import inspect
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import upslope
from support.scripted import EPISODES, GAMMA, F, Scripted, level
from upslope.wrappers import vector


def scripted():
    return Scripted(*EPISODES)


class TestKinds:
    def test_a_single_environment(self):
        env = upslope.shape(scripted(), level, GAMMA, scale=2.0)
        assert type(env) is upslope.PotentialShaping
        env.reset(seed=0)
        assert env.step(0)[4]["shaping_reward"] == pytest.approx(2 * F[0])

    def test_a_vector_environment(self):
        envs = upslope.shape(gym.vector.SyncVectorEnv([scripted] * 2), level, GAMMA, scale=2.0)
        assert type(envs) is vector.PotentialShaping
        envs.reset(seed=0)
        np.testing.assert_allclose(envs.step(np.zeros(2, int))[4]["shaping_reward"], 2 * F[0], rtol=1e-6)

    def test_a_vec_env(self):
        vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
        from upslope.wrappers import sb3

        envs = upslope.shape(vec_env.DummyVecEnv([scripted] * 2), level, GAMMA, scale=2.0)
        assert type(envs) is sb3.PotentialShaping
        envs.reset()
        assert envs.step(np.zeros(2, int))[3][1]["shaping_reward"] == pytest.approx(2 * F[0])

    @pytest.mark.parametrize("env", [None, "CartPole-v1", level])
    def test_anything_else_raises_a_clear_error(self, env):
        with pytest.raises(upslope.UpslopeError, match=r"Gymnasium environment.*VecEnv"):
            upslope.shape(env, level, GAMMA)

    def test_an_unknown_setting(self):
        with pytest.raises(TypeError, match="scal"):
            upslope.shape(scripted(), level, GAMMA, scal=2.0)


def test_shaping_a_gymnasium_environment_imports_neither_stable_baselines3_nor_jax():
    program = (
        "import sys, gymnasium as gym, upslope\n"
        "env = upslope.shape(gym.make('CartPole-v1'), upslope.prior_path('cartpole'), 0.98)\n"
        "env.reset(seed=0), env.step(0)\n"
        "print(sorted({'stable_baselines3', 'torch', 'jax', 'equinox'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_every_wrapper_documents_every_argument():
    pytest.importorskip("stable_baselines3")
    from upslope.wrappers import sb3

    constructors = [module.PotentialShaping.__init__ for module in (upslope, vector, sb3)]
    names = [name for name in inspect.signature(constructors[0]).parameters if name != "self"]
    assert all(set(names) <= set(inspect.signature(one).parameters) for one in constructors)
    for function in (*constructors, upslope.shape):
        text = inspect.getdoc(function)
        assert all(f"\n    {name}: " in text for name in names)
