"""Every benchmark has a short form that runs to its end, so that none falls behind the code that it measures."""

import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks
from benchmarks import harness

ROOT = Path(__file__).parents[2]
HELPERS = {"harness", "provenance", "compile_costs", "learning_curves", "host_environments", "convolutional_step",
           "going", "phases"}  # fmt: skip
NO_BENCHMARKS = HELPERS | {"plots", "report", "clients_report", "peers"}
#: Has an option of its own for it, and no table of seconds.
ELSEWHERE = {"clients"}
NAMES = sorted({module.name for module in pkgutil.iter_modules(benchmarks.__path__)} - NO_BENCHMARKS - ELSEWHERE)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_short_form_writes_its_table(name):
    written = harness.RESULTS / "quick" / f"{name}.json"
    written.unlink(missing_ok=True)
    command = [sys.executable, "-m", f"benchmarks.{name}", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads(written.read_text())["rows"]
    assert rows
    assert all(row["median"] > 0 for row in rows.values())
