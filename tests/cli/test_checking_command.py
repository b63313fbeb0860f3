"""``upslope check`` as a user types it: exit codes, what it prints, and places that can't be found."""

import subprocess
import sys

import pytest

from upslope import UpslopeError
from upslope.cli.check import Check
from upslope.cli.places import find_function

MODULE = """
import gymnasium as gym
import upslope

def phi(obs):
    return 5.0 - abs(float(obs[2]))

def right():
    return upslope.PotentialShaping(gym.make("upslope/CartPole-v0"), phi, gamma=0.9)

def unshaped():
    return gym.make("upslope/CartPole-v0")

def broken():
    raise RuntimeError("no licence")

number = 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "my_envs.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("my_envs", None)


def test_a_right_one(folder, capsys):
    Check("my_envs:right", "my_envs:phi", gamma=0.9, steps=300)()
    assert "Checked PotentialShaping" in capsys.readouterr().out


def test_a_prior_brings_its_own_gamma(folder, prior, capsys):
    prior.save("prior.safetensors")
    with pytest.raises(SystemExit) as caught:
        Check("my_envs:unshaped", "prior.safetensors", steps=100)()
    assert caught.value.code == 1
    assert "never_applied" in capsys.readouterr().out


def test_the_command_line(folder):
    command = [sys.executable, "-m", "upslope.cli.main", "check", "my_envs:right", "my_envs:phi", "--gamma", "0.95"]
    finished = subprocess.run([*command, "--steps", "300"], capture_output=True, text=True)
    assert finished.returncode == 1, finished.stderr
    assert "gamma_mismatch" in finished.stdout
    assert "which is γ = 0.9 and not 0.95" in finished.stdout


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("my_envs", "does not name anything"),
        ("my_envs:", "does not name anything"),
        ("my_envs:gone", "can't be imported"),
        ("gone:right", "can't be imported"),
        ("my_envs:number", "must be a function"),
    ],
)
def test_places_that_are_not_there(folder, place, words):
    with pytest.raises(UpslopeError, match=words):
        find_function(place)


def test_a_factory_that_raises(folder):
    with pytest.raises(UpslopeError, match=r"my_envs:broken failed \(RuntimeError: no licence\)"):
        Check("my_envs:broken", "my_envs:phi", gamma=0.9)()


def test_a_function_has_no_gamma(folder):
    with pytest.raises(UpslopeError, match="--gamma"):
        Check("my_envs:right", "my_envs:phi")()
