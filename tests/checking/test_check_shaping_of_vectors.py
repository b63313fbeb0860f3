"""The checker on vectors: every wrong wrapper inside and around them, in all autoreset modes, and in processes."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import Autoreset

from support import wrong_vector_wrappers as vectors
from support import wrong_wrappers as zoo
from support.scripted import Walk
from support.wrong_wrappers import GAMMA, WRONG, phi
from upslope import PotentialShaping, UpslopeError, check_shaping
from upslope.wrappers.vector import PotentialShaping as VectorShaping

WRONG_VECTORS = {
    vectors.VectorNeverApplied: "never_applied",
    vectors.VectorTerminalPotential: "nonzero_terminal_potential",
    vectors.VectorZeroedAtTruncation: "zeroed_at_truncation",
    vectors.VectorAnotherGamma: "gamma_mismatch",
    vectors.VectorClippedF: "clipped",
    vectors.VectorClippedReward: "clipped",
    vectors.VectorCentred: "normalised",
}
MODES = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)


def names(report):
    return [finding.name for finding in report.findings]


def caught_inside(wrong, mode, seed):
    env = SyncVectorEnv([lambda: wrong(Walk())] * 2, autoreset_mode=mode)
    assert names(check_shaping(env, phi, GAMMA, steps=280, seed=seed)) == [WRONG[wrong]]


def caught_around(wrong, mode, seed):
    env = wrong(SyncVectorEnv([Walk] * 2, autoreset_mode=mode))
    assert names(check_shaping(env, phi, GAMMA, steps=300, seed=seed)) == [WRONG_VECTORS[wrong]]


@MODES
@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrapper: wrapper.__name__)
def test_wrong_sub_environments(wrong, mode):
    caught_inside(wrong, mode, 0)


@MODES
@pytest.mark.parametrize("wrong", WRONG_VECTORS, ids=lambda wrapper: wrapper.__name__)
def test_wrong_wrappers_of_vectors(wrong, mode):
    caught_around(wrong, mode, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
@MODES
def test_each_is_caught_whatever_the_seed(mode, seed):
    for wrong in WRONG:
        caught_inside(wrong, mode, seed)
    for wrong in WRONG_VECTORS:
        caught_around(wrong, mode, seed)


@pytest.mark.parametrize("wrong", [zoo.Growing, zoo.TerminalPotential, zoo.Centred])
def test_wrong_wrappers_below_autoreset(wrong):
    assert names(check_shaping(Autoreset(wrong(Walk())), phi, GAMMA, steps=600)) == [WRONG[wrong]]


@MODES
@pytest.mark.parametrize("around", [True, False])
def test_annealing_is_a_stale_mixture_inside_and_around_the_vector(mode, around):
    if around:
        env = VectorShaping(SyncVectorEnv([Walk] * 2, autoreset_mode=mode), phi, GAMMA, anneal_steps=1500)
    else:
        env = SyncVectorEnv([lambda: PotentialShaping(Walk(), phi, GAMMA, anneal_steps=3000)] * 2, autoreset_mode=mode)
    assert names(check_shaping(env, phi, GAMMA, steps=600)) == ["stale_mixture"]


def cartpole():
    return gym.make("CartPole-v1")


def shaped():
    return PotentialShaping(Walk(), phi, GAMMA)


def shaped_by_another():
    return zoo.Right(Walk())


class TestWorkerProcesses:
    @MODES
    def test_shaping_inside_them_is_checked_with_their_reported_raw_rewards(self, mode):
        env = AsyncVectorEnv([shaped] * 2, autoreset_mode=mode, context="spawn")
        right = check_shaping(env, phi, GAMMA, steps=300)
        wrong = check_shaping(env, phi, 0.95, steps=300)
        env.close()
        assert right.findings == (), str(right)
        assert min(right.counts.values()) >= 1
        assert names(wrong) == ["gamma_mismatch"]

    @pytest.mark.parametrize("make", [shaped_by_another, Walk])
    def test_hidden_raw_rewards_are_refused(self, make):
        env = AsyncVectorEnv([make] * 2, context="spawn")
        with pytest.raises(UpslopeError, match="workers hide their raw rewards: check one environment alone"):
            check_shaping(env, phi, GAMMA, steps=50)
        env.close()

    def test_missing_ends_are_reported(self):
        env = vectors.VectorZeroedAtTruncation(AsyncVectorEnv([cartpole] * 2, context="spawn"))
        report = check_shaping(env, phi, GAMMA, steps=200)
        env.close()
        assert "not_judged" in names(report)
        assert not report.ok
        assert "kinds: truncated, both" in report.findings[0].evidence
        in_process = vectors.VectorZeroedAtTruncation(SyncVectorEnv([cartpole] * 2))
        assert "zeroed_at_truncation" in names(check_shaping(in_process, phi, GAMMA, steps=200))


def test_a_vector_without_sub_environments():
    env = gym.make_vec("CartPole-v1", 2, vectorization_mode="vector_entry_point")
    assert names(check_shaping(env, phi, GAMMA, steps=100))[0] == "never_applied"


class GrowingObservations(Walk):
    """Its observations grow after a few steps."""

    steps = 0

    def step(self, action):
        obs, *rest = super().step(action)
        self.steps += 1
        return np.append(obs, obs[0]) if self.steps > 5 else obs, *rest


class Nested(gym.ObservationWrapper):
    """The same inside a dictionary and a tuple."""

    def __init__(self, env):
        super().__init__(env)
        self.observation_space = gym.spaces.Dict({"parts": gym.spaces.Tuple([env.observation_space])})

    def observation(self, observation):
        return {"parts": (observation,)}


class TestObservationsThatChangeShape:
    @pytest.mark.parametrize(
        "env",
        [
            lambda: PotentialShaping(GrowingObservations(), phi, GAMMA),
            lambda: zoo.Right(GrowingObservations()),
            lambda: VectorShaping(SyncVectorEnv([GrowingObservations] * 2), phi, GAMMA),
            lambda: SyncVectorEnv([lambda: zoo.Right(GrowingObservations())] * 2),
        ],
        ids=["ours", "theirs", "vector", "sub-environments"],
    )
    def test_have_their_own_finding(self, env):
        report = check_shaping(env(), phi, GAMMA, steps=100)
        assert names(report) == ["wrong_observation_shape"]
        assert "of shape (3,), but its observation space says (2,)" in report.findings[0].evidence
        assert report.findings[0].step in (5, 6, 7)
        assert not report.ok

    def test_within_dictionaries_and_tuples(self):
        def inner(obs):
            return phi(obs["parts"][0])

        report = check_shaping(PotentialShaping(Nested(GrowingObservations()), inner, GAMMA), inner, GAMMA, steps=100)
        assert names(report) == ["wrong_observation_shape"]
        assert check_shaping(PotentialShaping(Nested(Walk()), inner, GAMMA), inner, GAMMA, steps=300).findings == ()
