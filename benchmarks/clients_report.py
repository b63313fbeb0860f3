"""The numbers and the picture of `benchmarks.clients`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

ARMS = {"unshaped": "no shaping", "constant": "constant potential", "shaped": "meta-learned prior"}
GOAL = 195.0
_COLOURS = {"unshaped": "tab:gray", "constant": "tab:orange", "shaped": "tab:blue"}


@dataclass(frozen=True)
class Run:
    """One learner on one pole.

    Attributes:
        algorithm: its name in Stable-Baselines3.
        seed: of everything random, the pole's length included.
        arm: one of `ARMS`.
        length: of the pole, in metres.
        every: steps between evaluations.
        returns: raw greedy returns, the first before any learning.
        seconds: of the run.
        variant: of the settings, if they are not those of the benchmark.
    """

    algorithm: str
    seed: int
    arm: str
    length: float
    every: int
    returns: list[float]
    seconds: float
    variant: str = ""

    @property
    def name(self) -> tuple[str, int, str]:
        return self.algorithm, self.seed, self.arm

    @property
    def first_at_goal(self) -> float:
        """Steps until the raw return first reached 195; infinity for never."""
        reached = np.flatnonzero(np.asarray(self.returns) >= GOAL)
        return float(reached[0] * self.every) if reached.size else np.inf


def write_report(runs: list[Run], about: dict[str, Any], folder: Path) -> None:
    """Writes ``results.json`` and ``figure.png``, and prints a table."""
    rows = {name: _algorithm([run for run in runs if run.algorithm == name]) for name in about["settings"]}
    text = json.dumps({"goal": GOAL, "algorithms": rows, **about}, indent=1)
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")
    _draw(rows, folder / "figure.png")
    for name, row in rows.items():
        title = f"{name}, {row['steps']} steps, {len(row['lengths'])} poles"
        table = Table("", "median steps to 195", "reached", "mean return", "lower quartile at the end", title=title)
        for arm, words in ARMS.items():
            numbers = row["arms"][arm]
            median = "not reached" if numbers["median_first"] is None else f"{numbers['median_first']:.0f}"
            reached = sum(first is not None for first in numbers["first"])
            table.add_row(words, median, str(reached), f"{numbers['mean']:.0f}", f"{numbers['q1'][-1]:.0f}")
        Console().print(table)


def _algorithm(runs: list[Run]) -> dict[str, Any]:
    """The numbers of one algorithm; None stands for never."""
    first, every = runs[0], runs[0].every
    arms = {}
    for arm in ARMS:
        of_arm = [run for run in runs if run.arm == arm]
        curves = np.asarray([run.returns for run in of_arm])
        q1, median, q3 = np.percentile(curves, [25, 50, 75], axis=0)
        steps = [run.first_at_goal for run in of_arm]
        # Of an even number of runs the median lies between two; with one of them at never it is never.
        middle = float(np.median(steps)) if np.isfinite(np.sort(steps)[len(steps) // 2]) else np.inf
        arms[arm] = {
            "first": [_or_none(step) for step in steps],
            "median_first": _or_none(middle),
            "mean": float(curves.mean()),
            "median": median.tolist(),
            "q1": q1.tolist(),
            "q3": q3.tolist(),
            "seconds": sum(run.seconds for run in of_arm),
        }
    shaped = arms["shaped"]["median_first"]
    total = every * (len(first.returns) - 1)
    return {
        "steps": total,
        "every": every,
        "lengths": [run.length for run in runs if run.arm == "shaped"],
        "arms": arms,
        # Where the others never reached it, this is a lower bound of the ratio.
        "times_fewer_steps": {
            arm: {
                "factor": (arms[arm]["median_first"] or total) / shaped,
                "at_least": arms[arm]["median_first"] is None,
            }
            for arm in ("unshaped", "constant")
            if shaped
        },
    }


def _or_none(steps: float) -> float | None:
    return steps if np.isfinite(steps) else None


def _draw(rows: dict[str, Any], path: Path) -> None:
    figure = Figure(figsize=(4 * len(rows), 3.5), layout="constrained")
    axes = figure.subplots(1, len(rows), sharey=True, squeeze=False)[0]
    for axis, (name, row) in zip(axes, rows.items(), strict=True):
        for arm, words in ARMS.items():
            curves = row["arms"][arm]
            steps = row["every"] * np.arange(len(curves["median"]))
            axis.plot(steps, curves["median"], label=words, color=_COLOURS[arm])
            axis.fill_between(steps, curves["q1"], curves["q3"], color=_COLOURS[arm], alpha=0.2, linewidth=0)
        axis.axhline(GOAL, color="black", linewidth=0.5, linestyle=":")
        axis.set(title=f"Stable-Baselines3 {name}", xlabel="environment steps", ylim=(0, 205))
    axes[0].set_ylabel("raw greedy return")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize="small", loc="outside lower center", ncols=len(rows))
    figure.savefig(path, dpi=150)
