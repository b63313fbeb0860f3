"""The verdict on priors made by hand: the true values, their opposite, a constant, and values of the wrong task."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

from support.corridor import Known, constant, corridors, optimal
from upslope.evaluation.learner_test import LearnerTest, compare_learners
from upslope.evaluation.picture import draw
from upslope.evaluation.signs import signs
from upslope.evaluation.verdict import Verdict
from upslope.learners.dqn import DQNConfig

TASKS = jnp.array([0, 1] * 4)
DQN = DQNConfig(
    hidden=(16,), learning_rate=0.01, decay_updates=0, batch_size=32, warmup_steps=40, steps_per_update=4,
    epsilon=0.2, evaluation_episodes=1,
)  # fmt: skip


def verdict_on(network):
    family, key = corridors(), jax.random.key(1)
    found = signs(family, network, TASKS, key)
    test = compare_learners(family, network, found.level, TASKS, key, DQN, updates=400, every=40)
    return Verdict(family.name, found, test)


@pytest.fixture(scope="module")
def good():
    return verdict_on(optimal())


def test_true_values_are_useful(good):
    assert good.word == "useful"
    assert good.sentence.startswith("Useful: over the first 400 updates a shaped DQN")
    assert good.test.areas("shaped").mean() > 0.8


@pytest.mark.parametrize(
    ("network", "words"),
    [
        (Known(-5 * optimal().table), {"harmful", "doubtful"}),
        (Known(optimal().table[::-1]), {"harmful", "doubtful"}),
        (Known(jax.random.normal(jax.random.key(5), (2, 21, 2))), {"harmful", "doubtful"}),
        (constant(0.5), {"flat"}),
    ],
    ids=["sign flipped", "the other task's", "noise", "constant"],
)
def test_others_are_not(network, words):
    verdict = verdict_on(network)
    assert verdict.word in words
    assert verdict.sentence.count(".") >= 1


def test_a_constant_arm_is_shaped_by_the_level_alone():
    """A constant prior's own arm and the constant arm are the same learners."""
    verdict = verdict_on(constant(0.5))
    np.testing.assert_array_equal(verdict.test.returns["shaped"], verdict.test.returns["constant"])


def of_learners(shaped, unshaped, constant):
    """A verdict from areas ``[tasks]``."""
    rows = {"shaped": shaped, "unshaped": unshaped, "constant": constant}
    return LearnerTest(
        "dqn", np.array([0, 5, 10]), {arm: np.tile(np.asarray(v)[:, None], 3) for arm, v in rows.items()}
    )


class TestWords:
    FAR, NEAR, LOW = [10.0, 11.0, 9.0, 10.0], [9.9, 11.2, 8.9, 10.1], [1.0, 2.0, 0.0, 1.0]

    @pytest.mark.parametrize(
        ("areas", "word"),
        [
            ((FAR, LOW, LOW), "useful"),
            ((FAR, LOW, NEAR), "doubtful"),
            ((FAR, NEAR, LOW), "doubtful"),
            ((LOW, FAR, LOW), "harmful"),
            ((LOW, FAR, FAR), "harmful"),
        ],
    )
    def test_they_follow_the_intervals(self, good, areas, word):
        assert replace(good, test=of_learners(*areas)).word == word

    def test_without_learners_it_stays_doubtful(self, good):
        verdict = replace(good, test=None)
        assert verdict.word == "doubtful"
        assert "no learner was trained" in verdict.sentence

    def test_the_interval_is_that_of_paired_differences(self):
        gain = of_learners([3.0, 13.0, 103.0], [2.0, 12.0, 102.0], [0.0] * 3).gain("unshaped")
        assert (gain.mean, gain.low, gain.high) == (1.0, 1.0, 1.0)


def test_json_holds_the_numbers(good):
    content = json.loads(good.to_json())
    assert content["verdict"] == "useful"
    assert content["signs"]["greedy"] == [1.0] * 8
    assert np.shape(content["learners"]["returns"]["shaped"]) == (8, 11)
    assert content["learners"]["gain_over_unshaped"]["low"] > 0


@pytest.mark.parametrize("with_learners", [True, False])
def test_the_picture_is_drawn(good, with_learners, tmp_path):
    draw(good if with_learners else replace(good, test=None), tmp_path / "verdict.png")
    height, width, _ = plt.imread(tmp_path / "verdict.png").shape
    assert width / height == pytest.approx((12 if with_learners else 8) / 3.4, rel=0.02)
