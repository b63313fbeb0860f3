"""The README's Python runs as printed, and its commands exist."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import upslope

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


def test_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert (tmp_path / "cartpole.safetensors").is_file()
    assert names["adapted"].returns.shape == (21,)
    assert names["result"].returns.shape == (11,)
    agent = upslope.Agent.load(tmp_path / "agent.safetensors")
    first_line, action = capsys.readouterr().out.splitlines()[:2]
    assert first_line.startswith("[")
    assert agent.act([0.0, 0.1, 0.05, -0.2]) == int(action)
    assert names["shaped"].gamma == 0.98


@pytest.mark.parametrize("command", sorted(set(re.findall(r"`upslope ([a-z-]+)", README))))
def test_commands_exist(command: str) -> None:
    finished = subprocess.run(
        [sys.executable, "-m", "upslope.cli.main", command, "--help"], capture_output=True, text=True
    )
    assert finished.returncode == 0
    assert command in finished.stdout


def test_the_make_targets_exist() -> None:
    makefile = (Path(__file__).parents[2] / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([a-z-]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)
