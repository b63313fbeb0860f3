"""Reading results and writing numbers: what the tables of all pages share."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

DATA = Path(__file__).parents[1] / "data"


def load(name: str) -> dict[str, Any]:
    """The results.json of one experiment."""
    return json.loads((DATA / name / "results.json").read_text(encoding="utf-8"))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def number(value: float, digits: int) -> str:
    """A number with a proper minus sign, and none before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def interval(gap: dict[str, float], digits: int) -> str:
    """A mean difference with its 95 % interval."""
    return "{} ({} to {})".format(*(number(gap[name], digits) for name in ("mean", "low", "high")))


def seed_range(seeds: Sequence[float], digits: int) -> str:
    """The mean over seeds, with the lowest and the highest."""
    mean = sum(seeds) / len(seeds)
    return "{} ({} to {})".format(*(number(value, digits) for value in (mean, min(seeds), max(seeds))))


def or_never(updates: float | None) -> str:
    """A number of updates, if it was ever reached."""
    return "never" if updates is None else f"{updates:.0f}"
