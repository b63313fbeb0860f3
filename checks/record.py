"""The stored result of ``make check-all``, and the README's line that shows it."""

import json
import os
import platform
import re
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
STORED = ROOT / "docs" / "data" / "check-all.json"

BEGIN, END = "<!-- check-all: written by `make check-all` -->", "<!-- end of check-all -->"


def commit() -> str:
    """The commit in the working tree, and whether files differ from it. Ask before the jobs, which write files."""
    changed = _git("status", "--porcelain", "--untracked-files=no")
    return _git("rev-parse", "HEAD") + (", changed since" if changed else "")


def record(commit: str, results: list[dict[str, Any]]) -> dict[str, Any]:
    """What is stored of a run: date, commit, jobs, minutes, and the machine's cores and system."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": commit,
        "passed": all(result["passed"] for result in results),
        "minutes": round(sum(result["minutes"] for result in results), 1),
        "machine": {"cores": os.cpu_count(), "system": platform.system()},
        "jobs": results,
    }


def write(content: dict[str, Any], path: Path) -> None:
    """Stores a result."""
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def line(path: Path) -> str:
    """The README's line for a stored result, or for none."""
    if not path.is_file():
        return "`make check-all`, which runs everything that is too long for CI, has no stored result yet."
    content = json.loads(path.read_text(encoding="utf-8"))
    failed = [job["name"] for job in content["jobs"] if not job["passed"]]
    verdict = f"failed: {', '.join(failed)}" if failed else f"all {len(content['jobs'])} jobs passed"
    tests = [f"{job['tests']['passed']:,} tests" for job in content["jobs"] if "tests" in job]
    machine, commit = content["machine"], content["commit"]
    amount = ", ".join((*tests, f"{content['minutes']:.0f} minutes"))
    return (
        f"Last `make check-all`, which runs everything that is too long for CI: {content['date']}, "
        f"commit {commit[:10]}{commit[40:]}, {verdict} ({amount}, "
        f"{machine['cores']} cores, {machine['system']})."
    )


def readme_with(text: str, path: Path) -> str:
    """The README with the line of a stored result between its markers."""
    new, found = re.subn(
        f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: f"{BEGIN}\n{line(path)}\n{END}", text, flags=re.DOTALL
    )
    if found != 1:
        raise ValueError(f"The README needs exactly one pair of the markers {BEGIN!r} and {END!r}.")
    return new


def _git(*arguments: str) -> str:
    """What git prints; nothing outside of a checkout."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=False, capture_output=True, text=True)
    return done.stdout.strip()
