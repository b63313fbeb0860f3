"""The jobs of ``make check-all``, and how one is run."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree


class Job(NamedTuple):
    """One command.

    Attributes:
        name: what it checks.
        command: its arguments.
        report: the JUnit file that it writes, if it runs tests.
        files: that must be there, and not be empty, at its end.
    """

    name: str
    command: tuple[str, ...]
    report: Path | None = None
    files: tuple[Path, ...] = ()


def all_jobs(folder: Path) -> list[Job]:
    """Everything, shortest first.

    Args:
        folder: an empty one for what the jobs write.
    """
    figure, report = folder / "fig1", folder / "tests.xml"
    names = ("figure.png", "figure.pdf", "returns.npz", "results.json", "report.html")
    python = (sys.executable, "-m")
    return [
        Job(
            "Figure 1, quick form",
            (*python, "upslope.cli.main", "reproduce", "fig1", "--quick", "--out", str(figure)),
            files=tuple(figure / name for name in names),
        ),
        Job("Tianshou example", ("make", "tianshou")),
        Job("reliability", (*python, "reliability")),
        Job(
            "tests, fast and slow",
            (*python, "pytest", "-m", "", "-n", "2", "--dist", "loadfile", f"--junitxml={report}"),
            report=report,
        ),
    ]


def run(job: Job, root: Path) -> dict[str, Any]:
    """Runs one job to its end.

    Args:
        job: which one.
        root: the folder that it runs in.

    Returns:
        Its name, whether it passed, its minutes and, if it runs tests, how many passed, failed and were skipped.
    """
    print(f"{job.name}: {' '.join(job.command)}", flush=True)
    began = time.monotonic()
    code = subprocess.run(job.command, cwd=root, check=False).returncode
    missing = [path.name for path in job.files if not path.is_file() or path.stat().st_size == 0]
    if missing:
        print(f"{job.name} did not write {', '.join(missing)}.", file=sys.stderr)
    minutes = round((time.monotonic() - began) / 60, 1)
    result: dict[str, Any] = {"name": job.name, "passed": code == 0 and not missing, "minutes": minutes}
    if job.report is not None and job.report.is_file():
        result["tests"] = counts(job.report)
    return result


def counts(report: Path) -> dict[str, int]:
    """How many tests of a JUnit file passed, failed and were skipped."""
    suites = ElementTree.parse(report).getroot().findall("testsuite")
    total, failures, errors, skipped = (
        sum(int(suite.get(name, "0")) for suite in suites) for name in ("tests", "failures", "errors", "skipped")
    )
    return {"passed": total - failures - errors - skipped, "failed": failures + errors, "skipped": skipped}
