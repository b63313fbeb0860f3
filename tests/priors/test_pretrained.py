"""The prior that ships: what its card says is so, the file is the command's, and it solves poles it never saw."""

import json
import subprocess
import sys
from dataclasses import asdict
from hashlib import sha256

import gymnasium as gym
import jax
import pytest

import upslope
from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.poles.shipped_prior import ShippedPriorConfig, card, quick_shipped_prior, shipped_prior
from upslope.experiments.priors import zero_shot_returns
from upslope.priors import pretrained
from upslope.priors.prior import Prior
from upslope.tasks import cartpoles

FILE = pretrained.prior_path("cartpole")
RESULTS = json.loads(FILE.with_suffix(".json").read_text(encoding="utf-8"))
PRIOR = upslope.load_prior("cartpole")

#: Settings that came later, as they are where nothing was changed.
ADDED_SINCE = {"longest_hold": 1, "random_iterations": 0, "kept_iterations": 1, "normalise": False}


def test_the_file_is_the_one_that_the_command_wrote():
    assert sha256(FILE.read_bytes()).hexdigest() == RESULTS["sha256"]
    assert PRIOR.trained_on.seed == RESULTS["chosen_seed"]
    now, then = json.loads(json.dumps(asdict(ShippedPriorConfig()))), json.loads(json.dumps(RESULTS["configuration"]))
    then["meta_training"] = ADDED_SINCE | then["meta_training"]
    assert then == now


def test_the_card_is_made_of_the_numbers():
    assert pretrained.card("cartpole") == card(PRIOR, RESULTS)
    row = next(row for row in RESULTS["priors"] if row["seed"] == RESULTS["chosen_seed"])
    assert f"| {row['zero_shot_mean']:.2f} |" in pretrained.card("cartpole")
    assert "MIT" in pretrained.card("cartpole")


def test_it_balances_poles_that_nobody_looked_at():
    family = cartpoles()
    tasks = family.sample_many(key_for(123_456, Purpose.TEST_TASKS), 40)
    one = jax.tree.map(lambda leaf: leaf[None], PRIOR.network)
    returns = zero_shot_returns(family, one, tasks, jax.random.key(0))
    assert float(returns.mean()) > 195


def test_it_was_chosen_by_training_tasks_alone():
    best = max(row["return_on_training_tasks"] for row in RESULTS["priors"])
    first = next(row["seed"] for row in RESULTS["priors"] if row["return_on_training_tasks"] == best)
    assert first == RESULTS["chosen_seed"]


def test_small_and_of_use_in_a_process_without_jax():
    assert FILE.stat().st_size < 20_000
    code = (
        "import sys, gymnasium as gym, upslope, upslope.priors.pretrained\n"
        "path = upslope.priors.pretrained.prior_path('cartpole')\n"
        "env = upslope.PotentialShaping(gym.make('CartPole-v1'), path, gamma=0.98)\n"
        "print(env.reset(seed=0)[1]['potential'], 'jax' in sys.modules)"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    value, has_jax = finished.stdout.split()
    env = upslope.PotentialShaping(gym.make("CartPole-v1"), PRIOR, gamma=PRIOR.gamma)
    assert float(value) == pytest.approx(env.reset(seed=0)[1]["potential"], abs=1e-9)
    assert 20 < float(value) < 50, "upright is worth many of the 50 that 0.98 allows"
    assert has_jax == "False"


def test_no_such_prior():
    with pytest.raises(
        pretrained.UnknownPriorError, match=r"No prior 'chess' ships with upslope: choose one of cartpole,"
    ):
        upslope.load_prior("chess")


@pytest.mark.slow
def test_the_command_writes_a_prior_its_numbers_and_its_card(tmp_path):
    prior, results = shipped_prior(quick_shipped_prior(ShippedPriorConfig()))
    prior.save(tmp_path / "prior.safetensors")
    again = Prior.load(tmp_path / "prior.safetensors")
    assert (
        again.trained_on.settings["zero_shot_mean"] == results["priors"][prior.trained_on.seed - 9000]["zero_shot_mean"]
    )
    assert results["shaped_dqn"].keys() == {"unshaped", "constant", "prior"}
    assert f"| **{prior.trained_on.seed}** |" in card(prior, results)
