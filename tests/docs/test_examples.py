"""Every example runs in its short form; those of other libraries only where these are installed."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

#: The arguments of each run, and the modules that it needs.
RUNS = {
    "own_family": ([], ()),
    "single_file_dqn": ([], ("torch",)),
    "sb3_discrete-DQN": (["--algorithm", "DQN"], ("stable_baselines3",)),
    "sb3_discrete-PPO": (["--algorithm", "PPO"], ("stable_baselines3",)),
    "sb3_continuous-SAC": (["--algorithm", "SAC"], ("stable_baselines3",)),
    "sb3_continuous-TD3": (["--algorithm", "TD3"], ("stable_baselines3",)),
    "sb3_continuous-DDPG": (["--algorithm", "DDPG"], ("stable_baselines3",)),
    "sbx_dqn": ([], ("sbx",)),
    "gymnax_family": ([], ("gymnax",)),
    "tianshou_dqn": ([], ("tianshou",)),  # in an environment of its own
}


def test_all_are_listed():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {run.partition("-")[0] for run in RUNS}


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_it_runs(run):
    arguments, modules = RUNS[run]
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        pytest.skip(f"{missing[0]} is not installed")
    command = [sys.executable, str(EXAMPLES / f"{run.partition('-')[0]}.py"), "--quick", *arguments]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    finished = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert finished.returncode == 0, finished.stderr
    for arm in ("unshaped", "shaped"):
        assert re.search(rf"(^|, ){arm}: .*\d", finished.stdout, re.MULTILINE), finished.stdout
