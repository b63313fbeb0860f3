"""The command line on maps: the recipe as default, and one prior through all verbs."""

import sys
from dataclasses import replace

import pytest

from upslope.cli.main import main, parse
from upslope.cli.meta_train import MetaTrain
from upslope.learners.dqn import DQNConfig, for_maps
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.meta_training.recipes import as_printed, for_grid_games
from upslope.priors.prior import Prior


@pytest.mark.parametrize(("family", "iterations"), [("grid", 8000), ("obstacles", 8000), ("clean", 3000)])
def test_the_defaults_are_the_family_s_recipe(family, iterations):
    command = parse(["meta-train", family])
    assert isinstance(command, MetaTrain)
    assert command.config == for_grid_games(iterations)


def test_options_change_single_settings():
    command = parse(["meta-train", "--inner-steps", "1", "grid", "--size", "5", "6", "--gamma", "0.8"])
    assert command.config == for_grid_games().with_posterior(inner_steps=1)
    assert command.tasks.size == (5, 6)
    assert command.tasks.build().gamma == 0.8


def test_poles_have_their_own_recipe():
    assert parse(["meta-train", "cartpole"]).config == MetaTrainingConfig()
    assert parse(["meta-train"]).config == MetaTrainingConfig()
    assert parse(["meta-train", "cartpole", "--printed"]).config == as_printed()


def test_another_posterior():
    command = parse(["meta-train", "grid", "--posterior", "network", "--inner-steps", "2"])
    assert command.config == replace(for_grid_games(), posterior=NetworkPosterior(inner_steps=2))


def test_learners_have_the_family_s_settings():
    assert parse(["train", "dqn", "--family", "clean"]).config == for_maps()
    assert parse(["train", "dqn", "--epsilon", "0.2"]).config == DQNConfig(epsilon=0.2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["reproduce", "all", "--seeds", "2"], "own seeds, tasks, iterations, priors"),
        (["train", "ddpg", "--family", "obstacles"], "DDPG needs continuous actions"),
        (["meta-train", "grid", "--obstacles", "1.5"], "obstacles is 1.5"),
    ],
)
def test_bad_input(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["upslope", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_one_prior_through_all_verbs(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("UPSLOPE_CACHE", str(tmp_path / "cache"))
    small = ["--iterations", "2", "--environments", "2", "--steps-per-task", "10", "--evaluation-tasks", "2"]
    file, maps = tmp_path / "prior" / "prior.safetensors", ["--size", "4", "4"]
    for arguments in (
        ["meta-train", "grid", *maps, *small, "--hidden", "8", "8", "--out", str(tmp_path / "prior")],
        ["train", "dqn", "--family", "grid", *maps, "--prior", str(file), "--updates", "2", "--out", f"{tmp_path}/dqn"],
        ["adapt", str(file), "--family", "grid", *maps, "--updates", "1", "--out", str(tmp_path / "a")],
    ):
        monkeypatch.setattr(sys, "argv", ["upslope", *arguments])
        main()
    assert Prior.load(file).trained_on.observation_shape == (4, 4, 4)
    assert Prior.load(tmp_path / "a" / "posterior.safetensors").gamma == 0.9
    assert "dqn on grid task 0" in " ".join(capsys.readouterr().out.split())
