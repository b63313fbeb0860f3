"""The command line: each verb does its work, and bad input ends in one sentence, exit code 2 and nothing written."""

import json
import sys
from pathlib import Path

import pytest

import upslope
from upslope import Agent
from upslope.cli.main import main
from upslope.priors.prior import Prior

SMALL = ["--iterations", "10", "--steps-per-task", "20", "--batch-size", "8"]


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["upslope", *arguments])
    main()


@pytest.fixture(scope="module")
def prior_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "prior"
    with pytest.MonkeyPatch.context() as patch:
        call(patch, "meta-train", "cartpole", *SMALL, "--seed", "3", "--out", str(folder))
    return folder / "prior.safetensors"


def test_meta_train_saves_a_prior_with_its_provenance(prior_file: Path) -> None:
    prior = Prior.load(prior_file)
    assert prior.gamma == 0.98
    assert prior.trained_on.family == "cartpole"
    assert prior.trained_on.seed == 3
    assert prior.trained_on.settings["iterations"] == 10
    assert list((prior_file.parent / "logs" / "meta-training").glob("events*"))


COUNTS = ["--updates", "10", "--every", "5", "--pole", "1.5"]


def test_train_with_shaping(
    prior_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    call(monkeypatch, "train", "dqn", "--prior", str(prior_file), *COUNTS, "--out", str(tmp_path / "a"))
    assert "dqn on a pole of 1.50 m" in " ".join(capsys.readouterr().out.split())
    agent = Agent.load(tmp_path / "a" / "agent.safetensors")
    assert agent.act([0.0, 0.1, 0.05, -0.2]) in (0, 1)
    assert agent.trained_on.learner == "dqn"
    lines = [json.loads(line) for line in (tmp_path / "a" / "logs" / "DQN" / "metrics.jsonl").read_text().splitlines()]
    assert [line["update"] for line in lines] == [0, 5, 10]


@pytest.mark.slow
def test_train_without_shaping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    call(monkeypatch, "train", "ddpg", *COUNTS, "--out", str(tmp_path / "b"))
    assert "ddpg on a pole of 1.50 m, no shaping" in " ".join(capsys.readouterr().out.split())
    assert Agent.load(tmp_path / "b" / "agent.safetensors").trained_on.learner == "ddpg"


@pytest.mark.slow
def test_adapt_saves_a_posterior(prior_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    call(monkeypatch, "adapt", str(prior_file), "--updates", "2", "--rule", "maml", "--out", str(tmp_path / "a"))
    posterior = Prior.load(tmp_path / "a" / "posterior.safetensors")
    assert posterior.trained_on == Prior.load(prior_file).trained_on


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["reproduce", "fig9"], ["'fig9'", "fig1"]),
        (["reproduce", "fig1", "--seeds", "0"], ["0 seeds"]),
        (["reproduce", "fig1", "--tasks", "-1"], ["-1 tasks"]),
        (["meta-train", "pendulum"], ["'pendulum'", "cartpole"]),
        (["meta-train", "cartpole", "--length", "5", "1"], ["5.0 to 1.0"]),
        (["meta-train", "cartpole", "--length", "-1", "1"], ["-1.0 to 1.0"]),
        (["meta-train", "cartpole", "--gamma", "1.5"], ["gamma is 1.5"]),
        (["meta-train", "cartpole", "--inner-steps", "0"], ["inner_steps is 0"]),
        (["train", "sarsa"], ["'sarsa'", "dqn"]),
        (["train", "dqn", "--pole", "-2"], ["-2.0 m"]),
        (["train", "dqn", "--updates", "0"], ["0 updates", "--updates"]),
        (["train", "dqn", "--prior", "nowhere.safetensors"], ["nowhere.safetensors"]),
        (["train", "dqn", "--batch-size", "0"], ["batch_size is 0"]),
        (["adapt", "nowhere.safetensors"], ["nowhere.safetensors", "cartpole"]),
        (["adapt", "cartpole", "--step-size", "-1"], ["step size is -1.0"]),
        (["adapt", "cartpole", "--rule", "sgd"], ["'sgd'", "maml"]),
        (["adapt", "cartpole", "--updates", "0"], ["0 updates", "--updates"]),
        (["meta-train", "cartpole", "--posterior", "tables"], ["'tables'", "table"]),
        (["meta-train", "nowhere:family"], ["nowhere:family can't be imported"]),
        (["meta-train", "upslope.tasks:FAMILIES"], ["is dict, but must be a family"]),
        (["train", "ddpg", "--family", "upslope.tasks:cartpoles"], ["DDPG needs continuous actions"]),
        (["meta-train", "--out", "clean", "grid"], ["Write grid directly after the command"]),
    ],
)
def test_bad_input(
    arguments: list[str],
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, *arguments)
    assert stop.value.code == 2
    message = capsys.readouterr().err.strip()
    assert message.startswith("upslope: ")
    assert len(message.splitlines()) == 1
    assert all(word in message for word in words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["meta-train", "cartpole", "--slip", "0.3"], "--slip"),
        (["meta-train", "cartpole", "--pole", "1"], "--pole"),
        (["meta-train", "grid", "--length", "1", "2"], "--length"),
        (["meta-train", "clean", "--obstacles", "0.1"], "--obstacles"),
        (["meta-train", "cartpole", "--reward-weight", "2"], "--reward-weight"),
        (["meta-train", "grid", "--outer-target", "kept"], "--outer-target"),
        (["meta-train", "upslope.tasks:cartpoles", "--length", "1", "2"], "--length"),
        (["train", "dqn", "--noise", "0.1"], "--noise"),
        (["train", "ddpg", "--epsilon", "0.1"], "--epsilon"),
        (["train", "dqn", "--family", "grid", "--pole", "1"], "--pole"),
        (["adapt", "cartpole", "--family=obstacles", "--pole", "1"], "--pole"),
    ],
)
def test_options_that_do_not_apply_are_errors(
    arguments: list[str], option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, *arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert "Unrecognized" in error
    assert option in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "shown", "hidden"),
    [
        (["meta-train", "cartpole"], {"--length", "--outer-target", "--iterations"}, {"--slip", "--reward-weight"}),
        (["meta-train", "grid"], {"--slip", "--size", "--reward-weight"}, {"--length", "--outer-target", "--name"}),
        (["meta-train", "grid", "--posterior", "network"], {"--outer-target"}, {"--reward-weight"}),
        (["train", "dqn", "--family", "clean"], {"--epsilon", "--target-rate"}, {"--pole", "--noise", "--slip"}),
        (["train", "ddpg"], {"--noise", "--pole"}, {"--epsilon", "--slip"}),
        (["adapt", "--family", "grid"], {"--size", "--step-size"}, {"--pole"}),
    ],
)
def test_help_shows_what_applies(
    arguments: list[str],
    shown: set[str],
    hidden: set[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, *arguments, "--help")
    assert stop.value.code == 0
    words = set(capsys.readouterr().out.replace(",", " ").split())
    assert shown <= words
    assert not hidden & words


def test_the_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, "--version")
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"upslope {upslope.__version__}\n"


@pytest.mark.parametrize("arguments", [["--gamma", "0.9"]])
def test_a_prior_of_other_tasks_is_refused(
    arguments: list[str],
    prior_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    for verb in (["train", "dqn", "--prior", str(prior_file)], ["adapt", str(prior_file)]):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SystemExit) as stop:
            call(monkeypatch, *verb, *arguments)
        assert stop.value.code == 2
        assert "gamma is 0.98 in the prior and 0.9 in the tasks" in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(
    prior_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    before = prior_file.read_bytes()
    for arguments in (["meta-train", "cartpole", *SMALL], ["reproduce", "fig1"], ["train", "dqn"]):
        with pytest.raises(SystemExit) as stop:
            call(monkeypatch, *arguments, "--out", str(prior_file.parent))
        assert stop.value.code == 2
        assert "nothing is overwritten" in capsys.readouterr().err
    assert prior_file.read_bytes() == before


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        (["--averaging", "1.5"], "averaging is 1.5"),
        (["--select-from", "-0.1"], "select_from is -0.1"),
        (["--epsilon", "0.5", "2.0"], "epsilon is 2.0"),
        (["--evaluation-tasks", "0"], "evaluation_tasks is 0"),
    ],
)
def test_settings_out_of_range(
    setting: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        call(monkeypatch, "meta-train", "cartpole", *setting)
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
