"""``upslope evaluate``: a verdict in words, numbers, a picture and the prior's card; and warnings of ``meta-train``."""

import inspect
import json
import sys

import jax
import pytest

import upslope
from support.corridor import PLACES, corridors
from upslope.cli.main import main
from upslope.meta_training.recipes import recipe_for
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import Prior, trained_on

FAMILY = "support.corridor:corridors"


@pytest.fixture(scope="module")
def prior():
    network = DuelingQ(jax.random.key(0), PLACES + 1, 2, (8,), (1.0,) * (PLACES + 1))
    return Prior(network, trained_on(corridors(), network, 0, {"made": "by hand"}))


@pytest.fixture(scope="module")
def folder(prior, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    prior.save(folder / "prior.safetensors")
    with pytest.MonkeyPatch.context() as patch:
        out = ("--out", str(folder / "verdict"), "--tasks", "3", "--learners", "2", "--updates", "3")
        patch.setattr(sys, "argv", ["upslope", "evaluate", str(folder / "prior.safetensors"), FAMILY, *out])
        main()
    return folder / "verdict"


def test_numbers_and_picture_are_written(folder):
    content = json.loads((folder / "verdict.json").read_text())
    assert content["family"] == "corridor"
    assert len(content["signs"]["greedy"]) == 3
    assert content["learners"]["updates"] == [0, 1, 2, 3]
    assert len(content["learners"]["returns"]["shaped"]) == 2
    assert (folder / "verdict.png").stat().st_size > 5000


def test_the_verdict_is_in_the_priors_card(folder, prior):
    judged = Prior.load(folder / "prior.safetensors")
    sentence = json.loads((folder / "verdict.json").read_text())["sentence"]
    assert judged.trained_on.settings == {"made": "by hand", "verdict": sentence}
    assert (judged.network.value_head.bias == prior.network.value_head.bias).all()


def test_in_python_it_is_the_same(folder, prior):
    verdict = upslope.evaluate(prior, corridors(), tasks=3, learners=2, updates=3, progress=False)
    assert verdict.to_dict() == json.loads((folder / "verdict.json").read_text())


@pytest.mark.parametrize(("counts", "words"), [({"tasks": 0}, "0 tasks"), ({"learners": -1}, "-1 learners")])
def test_bad_counts_are_refused(prior, counts, words):
    with pytest.raises(upslope.UpslopeError, match=words):
        upslope.evaluate(prior, corridors(), **counts)


def test_the_order_of_arguments_is_checked(prior):
    with pytest.raises(upslope.UpslopeError, match=r"call evaluate\(prior, family\)"):
        inspect.unwrap(upslope.evaluate)(corridors(), prior)


@pytest.mark.slow
def test_meta_training_warns_of_a_policy_that_learned_nothing():
    few = {"iterations": 1, "tasks": 2, "outer_updates": 1, "kept_iterations": 1, "random_iterations": 1}
    config = recipe_for(corridors(), hidden=(4,), evaluation_tasks=20, select_from=1.0, **few)
    with pytest.warns(upslope.PriorWarning, match="no better than random actions"):
        upslope.meta_train(corridors(), config=config, progress=False)
