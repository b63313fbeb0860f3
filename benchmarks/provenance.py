"""What a benchmark's result was made with: versions, the commit, the machine."""

import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from upslope.run.machine import hardware, versions

ROOT = Path(__file__).parents[1]

_PEERS = ("torch", "stable-baselines3", "sbx-rl", "gymnax", "flax")


def software() -> dict[str, str]:
    """Versions of all that takes part, and the commit where this runs in a checkout."""
    found = versions()
    for name in _PEERS:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found | ({"commit": commit} if (commit := _commit()) else {})


def machine() -> dict[str, Any]:
    """The machine and what it was busy with at the end.

    JAX's devices are those of the process that writes the result: where a benchmark lets other processes work (devices,
    memory, figures), theirs differ.
    """
    found = hardware()
    found["devices of the writing process"] = found.pop("devices")
    return found | _processor() | _memory() | {"kernel": platform.release(), "load": os.getloadavg()}


def _commit() -> str:
    """The checkout's commit, and whether files that git knows were changed since; empty where there is none."""
    try:
        if _git("rev-parse", "--show-toplevel") != str(ROOT):
            return ""
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", "src", "benchmarks/*.py")
        return _git("rev-parse", "HEAD") + (", changed since" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def _processor() -> dict[str, str]:
    """Details that distinguish processors of one name; only Linux reports them."""
    wanted = {"cpu family": "family", "model": "model", "stepping": "stepping", "cpu MHz": "MHz", "cache size": "cache"}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    except OSError:
        return {}
    said = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    return {f"processor's {ours}": said[theirs] for theirs, ours in wanted.items() if theirs in said}


def _memory() -> dict[str, float]:
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return {}
    return {"memory, GiB": round(size / 2**30, 1)}
