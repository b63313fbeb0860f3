"""Bad input of the checker: each kind raises a clear error."""

import numpy as np
import pytest

from support import wrong_wrappers as zoo
from support.scripted import Walk
from support.wrong_wrappers import GAMMA, phi
from upslope import UpslopeError, check_shaping


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((object(), phi, GAMMA), "not a Gymnasium environment"),
        ((Walk(), phi, 1.5), r"gamma is 1\.5"),
        ((Walk(), phi, "0.98"), "gamma is '0.98'"),
        ((Walk(), phi, True), "gamma is True"),
        ((Walk(), 3.0, GAMMA), "is not a potential"),
    ],
)
def test_bad_input(arguments, words):
    with pytest.raises(UpslopeError, match=words):
        check_shaping(*arguments)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"steps": 0}, "steps is 0"),
        ({"steps": 2.5}, r"steps is 2\.5"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": "a"}, "seed is 'a'"),
    ],
)
def test_bad_settings(setting, words):
    with pytest.raises(UpslopeError, match=words):
        check_shaping(Walk(), phi, GAMMA, **setting)


def test_numpy_scalars_are_accepted():
    report = check_shaping(zoo.Right(Walk()), phi, np.float32(GAMMA), steps=np.int64(600), seed=np.int64(0))
    assert report.findings == ()


def test_a_vector_environment_of_stable_baselines3():
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    with pytest.raises(UpslopeError, match="check one environment of it instead"):
        check_shaping(vec_env.DummyVecEnv([Walk]), phi, GAMMA)
