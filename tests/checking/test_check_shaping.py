"""The checker: it identifies each kind of wrong wrapper, and raises no false alarm on correct ones."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import Autoreset, NormalizeReward, RecordEpisodeStatistics, TimeLimit, TransformReward

from support import wrong_vector_wrappers as vectors
from support import wrong_wrappers as zoo
from support.scripted import Walk
from support.wrong_wrappers import GAMMA, WRONG, phi
from upslope import PotentialShaping, UpslopeError, check_shaping
from upslope.checking.findings import FIXES
from upslope.wrappers.vector import PotentialShaping as VectorShaping

SAME, NEXT = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP


def names(report):
    return [finding.name for finding in report.findings]


def caught(wrong, seed, steps):
    report = check_shaping(wrong(Walk()), phi, GAMMA, seed=seed, steps=steps)
    assert names(report) == [WRONG[wrong]]
    assert not report.ok
    finding = report.findings[0]
    assert finding.step > 0
    assert any(character.isdigit() for character in finding.evidence)
    assert finding.fix == FIXES[finding.name]


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrapper: wrapper.__name__)
def test_each_wrong_wrapper_has_exactly_its_finding(wrong):
    caught(wrong, 0, 600)


def test_two_mistakes_give_two_findings():
    report = check_shaping(zoo.LunarLanderStyle(Walk()), phi, GAMMA, steps=600)
    assert names(report) == ["gamma_mismatch", "nonzero_terminal_potential"]
    assert "which is γ = 1 and not 0.9" in report.findings[0].evidence


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 21))
@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrapper: wrapper.__name__)
def test_each_is_caught_whatever_the_seed(wrong, seed):
    caught(wrong, seed, 2000)


@pytest.mark.parametrize(
    ("vector", "mode", "name"),
    [
        (vectors.VectorResetObservation, SAME, "reset_observation_used"),
        (vectors.VectorDummyPaid, NEXT, "reset_observation_used"),
        (lambda env: vectors.Hides(vectors.VectorRight(env)), SAME, None),
        (lambda env: vectors.VectorRight(vectors.Hides(env)), SAME, "KeyError"),
    ],
)
def test_wrong_vector_wrappers(vector, mode, name):
    env = vector(SyncVectorEnv([Walk] * 2, autoreset_mode=mode))
    if name == "KeyError":
        with pytest.raises(UpslopeError, match=r"failed while it was checked \(KeyError"):
            check_shaping(env, phi, GAMMA, steps=500)
    else:
        assert names(check_shaping(env, phi, GAMMA, steps=500)) == ([name] if name else [])


def test_an_environment_that_hides_its_final_observation():
    class ResetObservationHidden(vectors.VectorResetObservation):
        def step(self, actions):
            *rest, infos = super().step(actions)
            infos.pop("final_obs", None)
            return (*rest, infos)

    env = ResetObservationHidden(SyncVectorEnv([Walk] * 2, autoreset_mode=SAME))
    assert names(check_shaping(env, phi, GAMMA, steps=500)) == ["hidden_final_observation"]


class ShapedInside(Walk):
    """Shapes its own reward, and reports the raw reward if ``report_raw`` is true."""

    def __init__(self, gamma, report_raw=True):
        self.gamma, self.report_raw = gamma, report_raw

    def reset(self, **arguments):
        obs, info = super().reset(**arguments)
        self.last = phi(obs)
        return obs, info

    def step(self, action):
        obs, reward, terminated, truncated, info = super().step(action)
        info = {"raw_reward": reward} if self.report_raw else {}
        reward += (0.0 if terminated else self.gamma * phi(obs)) - self.last
        self.last = phi(obs)
        return obs, reward, terminated, truncated, info


class TestBareEnvironments:
    def test_unshaped(self):
        for env in (Walk(), gym.make("CartPole-v1").unwrapped):
            report = check_shaping(env, phi, GAMMA, steps=300)
            assert names(report)[0] == "never_applied"
            assert report.layer == ""

    def test_shaped_inside(self):
        wrong = check_shaping(ShapedInside(0.8), phi, GAMMA, steps=600)
        assert "gamma_mismatch" in names(wrong)
        assert wrong.layer == "ShapedInside"
        hidden = check_shaping(ShapedInside(GAMMA, report_raw=False), phi, GAMMA, steps=600)
        assert names(hidden) == ["never_applied"]
        assert "info['raw_reward']" in str(hidden)


class TestPotentials:
    def test_not_finite(self):
        for env in (PotentialShaping(Walk(), zoo.breaking_phi, GAMMA), zoo.Right(Walk())):
            report = check_shaping(env, zoo.breaking_phi, GAMMA)
            assert names(report) == ["bad_potential"]
            assert "nan at the observation" in report.findings[0].evidence

    def test_wrong_shape(self):
        report = check_shaping(zoo.Right(Walk()), lambda obs: obs, GAMMA, steps=50)
        assert names(report) == ["bad_potential"]
        assert "shape (2,)" in report.findings[0].evidence

    def test_undefined_at_terminal_states_is_accepted(self):
        class Ending(Walk):
            def step(self, action):
                obs, reward, terminated, truncated, info = super().step(action)
                return obs, reward, terminated or obs[0] > 4.0, truncated, info

        assert (
            check_shaping(PotentialShaping(Ending(), zoo.breaking_phi, GAMMA), zoo.breaking_phi, GAMMA).findings == ()
        )

    def test_a_large_constant_level_is_a_finding_but_not_an_error(self):
        def high(obs):
            return 1000.0 + float(obs[0])

        report = check_shaping(PotentialShaping(Walk(), high, GAMMA), high, GAMMA)
        assert names(report) == ["large_constant_level"]
        assert report.ok
        assert report.level == pytest.approx(1000, abs=3)
        assert report.drip == pytest.approx(-100, abs=0.3)
        assert "pays -100" in report.findings[0].evidence


RIGHT = {
    "third party": lambda: zoo.Right(Walk()),
    "ours": lambda: PotentialShaping(Walk(), phi, GAMMA),
    "ours, scaled and shifted": lambda: PotentialShaping(Walk(), phi, GAMMA, scale=0.3, bias=-2.0),
    "above a monitor, a limit and a transformation": lambda: PotentialShaping(
        TransformReward(RecordEpisodeStatistics(TimeLimit(Walk(), 5)), lambda reward: 2 * reward + 1), phi, GAMMA
    ),
    "below a normalisation by a running scale": lambda: NormalizeReward(PotentialShaping(Walk(), phi, GAMMA), GAMMA),
    "around Autoreset": lambda: PotentialShaping(Autoreset(Walk()), phi, GAMMA),
    "below Autoreset": lambda: Autoreset(PotentialShaping(Walk(), phi, GAMMA)),
}


def passed(name, seed, steps):
    report = check_shaping(RIGHT[name](), phi, GAMMA, seed=seed, steps=steps)
    assert report.findings == (), str(report)
    assert report.layer in ("Right", "PotentialShaping")
    assert min(report.counts.values()) > 10, "each kind of end must have been judged"


@pytest.mark.parametrize("name", RIGHT)
def test_no_false_alarm(name):
    passed(name, 0, 600)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 21))
@pytest.mark.parametrize("name", RIGHT)
def test_no_false_alarm_whatever_the_seed(name, seed):
    passed(name, seed, 2000)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(
    "wrapper", [vectors.VectorRight, lambda env: VectorShaping(env, phi, GAMMA)], ids=["theirs", "ours"]
)
def test_no_false_alarm_on_vectors(wrapper, mode):
    report = check_shaping(wrapper(SyncVectorEnv([Walk] * 3, autoreset_mode=mode)), phi, GAMMA, steps=300)
    assert report.findings == (), str(report)
    assert min(report.counts.values()) > 10


def test_shaped_sub_environments():
    env = SyncVectorEnv([lambda: zoo.Right(Walk())] * 2)
    assert check_shaping(env, phi, GAMMA, steps=500).findings == ()
    env = SyncVectorEnv([lambda: zoo.TerminalPotential(Walk())] * 2)
    assert names(check_shaping(env, phi, GAMMA, steps=500)) == ["nonzero_terminal_potential"]


def test_worker_processes():
    env = VectorShaping(AsyncVectorEnv([Walk] * 2, context="spawn"), phi, GAMMA)
    report = check_shaping(env, phi, GAMMA, steps=300)
    env.close()
    assert report.findings == ()


def test_a_clip_above_the_shaping():
    env = TransformReward(PotentialShaping(Walk(), phi, GAMMA), lambda reward: float(np.clip(reward, -1, 1)))
    report = check_shaping(env, phi, GAMMA)
    assert names(report) == ["clipped"]
    assert "outside the shaping" in report.findings[0].evidence


def test_annealing_is_a_stale_mixture_for_a_replay():
    env = PotentialShaping(Walk(), phi, GAMMA, anneal_steps=3000)
    assert names(check_shaping(env, phi, GAMMA)) == ["stale_mixture"]


def test_an_unshaped_environment_and_a_prior(prior):
    assert names(check_shaping(gym.make("CartPole-v1"), prior, 0.98)) == ["never_applied"]
    assert check_shaping(PotentialShaping(gym.make("CartPole-v1"), prior, 0.98), prior, 0.98).findings == ()


def test_the_environment_is_unchanged():
    env = PotentialShaping(Walk(), phi, GAMMA)
    before = [dict(vars(layer)) for layer in (env, env.env)]
    check_shaping(env, phi, GAMMA, steps=50)
    for layer, attributes in zip((env, env.env), before, strict=True):
        assert set(vars(layer)) - set(attributes) <= {"_np_random", "_np_random_seed", "place"}
        assert not {"step", "reset"} & set(vars(layer))


def test_seeded():
    assert str(check_shaping(zoo.TwoVersions(Walk()), phi, GAMMA, seed=5)) == str(
        check_shaping(zoo.TwoVersions(Walk()), phi, GAMMA, seed=5)
    )
