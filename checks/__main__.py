"""``make check-all``: runs everything that is too long for CI, stores the result, and writes the README's line.

The stored result (``docs/data/check-all.json``) is always of a whole run: ``--only`` stores nothing.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro

from checks.jobs import all_jobs, run
from checks.record import ROOT, STORED, commit, readme_with, record, write


@dataclass(frozen=True)
class Options:
    """What to run."""

    only: str | None = None
    """Run only the jobs with this in their names, and store nothing."""
    list: bool = False
    """Print the jobs and run none."""


def main(options: Options) -> int:
    """Runs the jobs one after another; 1 if one of them failed."""
    before = commit()
    with tempfile.TemporaryDirectory() as folder:
        jobs = [job for job in all_jobs(Path(folder)) if options.only is None or options.only in job.name]
        if options.list:
            print("\n".join(f"{job.name}: {' '.join(job.command)}" for job in jobs))
            return 0
        results = [run(job, ROOT) for job in jobs]
    if options.only is None:
        write(record(before, results), STORED)
        update_readme()
    return 0 if all(result["passed"] for result in results) else 1


def update_readme() -> None:
    """Writes the line between the README's markers from the stored result."""
    path = ROOT / "README.md"
    path.write_text(readme_with(path.read_text(encoding="utf-8"), STORED), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
