"""A family of the user's on the command line, as MODULE:NAME: all verbs run on it."""

import sys

import pytest

from upslope import Agent, Prior
from upslope.cli.main import main

MODULE = """
import gymnasium as gym
import upslope

def make_env(length):
    return gym.make("upslope/CartPole-v0", length=length, max_episode_steps=12)

def family():
    return upslope.GymnasiumTasks(lambda rng: rng.uniform(0.5, 2.0), make_env, gamma=0.95, name="my poles")

made = family()
number = 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "my_tasks.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("my_tasks", None)


def call(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["upslope", *arguments])
    main()


@pytest.mark.slow
def test_all_verbs(folder, monkeypatch, capsys):
    small = ["--iterations", "2", "--tasks", "2", "--steps-per-task", "8", "--drawn-steps", "4", "--hidden", "4"]
    call(monkeypatch, "meta-train", "my_tasks:family", *small, "--evaluation-tasks", "1", "--out", "a")
    prior = Prior.load("a/prior.safetensors")
    assert (prior.trained_on.family, prior.gamma) == ("my poles", 0.95)
    file, family = "a/prior.safetensors", ["--family", "my_tasks:made"]
    call(monkeypatch, "train", "dqn", *family, "--prior", file, "--updates", "2", "--hidden", "4", "--out", "b")
    call(monkeypatch, "adapt", file, *family, "--updates", "1", "--steps-per-update", "8", "--out", "c")
    call(monkeypatch, "evaluate", file, "my_tasks:made", "--tasks", "2", "--learners", "0", "--out", "d")
    assert Prior.load("d/prior.safetensors").trained_on.settings["verdict"].startswith(("Of doubtful use", "Flat"))
    assert Agent.load("b/agent.safetensors").trained_on.family == "my poles"
    assert Prior.load("c/posterior.safetensors").gamma == 0.95
    assert "dqn on my poles task 0" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("my_tasks:gone", "can't be imported"),
        ("my_tasks:number", "is int, but must be a family"),
        ("my_tasks:make_env", "failed"),
    ],
)
def test_what_is_not_a_family(place, words, folder, monkeypatch, capsys):
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, "meta-train", place)
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
