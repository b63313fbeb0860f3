"""The command line on maps: the recipe as default, and one prior through all verbs."""

import sys

import pytest

from upslope.cli.commands import MetaTrain
from upslope.cli.main import main, parse
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_grid_games
from upslope.priors.prior import Prior


def parsed(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["upslope", *arguments])
    return parse()


@pytest.mark.parametrize(("family", "iterations"), [("grid", 8000), ("obstacles", 8000), ("clean", 3000)])
def test_the_defaults_are_the_family_s_recipe(family, iterations, monkeypatch):
    command = parsed(monkeypatch, "meta-train", family)
    assert isinstance(command, MetaTrain)
    assert command.config == for_grid_games(iterations)


def test_what_is_given_counts_even_if_it_is_the_default_elsewhere(monkeypatch):
    command = parsed(monkeypatch, "meta-train", "--inner-steps", "1", "grid", "--size", "5", "6", "--gamma", "0.8")
    assert command.config.inner_steps == MetaTrainingConfig().inner_steps == 1
    assert command.config.advantage_weight == for_grid_games().advantage_weight
    assert command.tasks.size == (5, 6)
    assert command.tasks.family("grid").gamma == 0.8


def test_poles_keep_theirs(monkeypatch):
    assert parsed(monkeypatch, "meta-train", "cartpole").config == MetaTrainingConfig()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["reproduce", "all", "--seeds", "2"], "own seeds, tasks, iterations and priors"),
        (["train", "ddpg", "--family", "obstacles"], "use dqn"),
        (["train", "dqn", "--family", "grid", "--pole", "1"], "no pole"),
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
    assert "dqn on map 0" in " ".join(capsys.readouterr().out.split())
