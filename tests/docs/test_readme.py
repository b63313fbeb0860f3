"""The README's Python runs as printed, and its commands exist."""

import functools
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import upslope
from upslope.cli.main import main

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")

#: Other defaults of the verbs, so that the fast tier learns for a moment only; the slow tier runs at full length.
SHORT = {
    "meta_train": {"config": upslope.MetaTrainingConfig(iterations=20)},
    "train": {"updates": 20, "every": 10},
    "adapt": {"updates": 2},
}


@pytest.mark.parametrize(
    ("defaults", "reports"), [(SHORT, 3), pytest.param({}, 11, marks=pytest.mark.slow)], ids=["short", "full"]
)
def test_python_runs(
    defaults: dict,
    reports: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    for verb, settings in defaults.items():
        monkeypatch.setattr(upslope, verb, functools.partial(getattr(upslope, verb), **settings))
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert (tmp_path / "cartpole.safetensors").is_file()
    assert names["adapted"].returns.shape == (21,)
    assert names["result"].returns.shape == (reports,)
    agent = upslope.Agent.load(tmp_path / "agent.safetensors")
    first_line, action = capsys.readouterr().out.splitlines()[:2]
    assert first_line.startswith("[")
    assert agent.act([0.0, 0.1, 0.05, -0.2]) == int(action)
    assert names["shaped"].gamma == 0.98


@pytest.mark.parametrize("command", sorted(set(re.findall(r"`upslope ([a-z-]+)", README))))
def test_commands_exist(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.setattr(sys, "argv", ["upslope", command, "--help"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 0
    assert command in capsys.readouterr().out


def test_the_make_targets_exist() -> None:
    makefile = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([a-z-]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)


def test_the_family_of_the_page_on_families_can_be_run() -> None:
    page = (Path(__file__).parents[2] / "docs" / "families.md").read_text(encoding="utf-8")
    names: dict = {}
    exec(compile("\n".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL)), "families.md", "exec"), names)
    family = names["family"]
    assert (family.actions.count, family.max_steps) == (5, 200)
    assert family.task_of(family.sample(0)) == names["sample"](np.random.default_rng(np.asarray(family.sample(0)))) > 5
