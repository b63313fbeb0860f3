"""The plots of ``docs/performance/``, drawn from the benchmarks' results."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

matplotlib.use("Agg")
from matplotlib import pyplot as plt

OURS, PEERS = "#1b6ca8", "#b0b0b0"

#: Bars whose lengths are in such a proportion are not seen together on a linear axis.
_FAR_APART = 50


def pictures(found: dict[str, Any]) -> dict[str, str]:
    """The pictures' paths from the pages, by benchmark."""
    return {name: f"{name}.png" for name in _DRAWN if name in found}


def draw_all(found: dict[str, Any], folder: Path) -> None:
    """Draws the benchmarks that have a plot."""
    for name, path in pictures(found).items():
        figure = _DRAWN[name](found[name])
        figure.savefig(folder / path, dpi=90, bbox_inches="tight", metadata={"Software": None})
        plt.close(figure)


def bars_of(pick: Callable[[str, Any], float | None], label: str) -> Callable[[Any], Any]:
    """Horizontal bars of one number of each row; upslope's in colour where there are others."""

    def draw(content: Any) -> Any:
        found = [(name, pick(name, row)) for name, row in content["rows"].items()]
        chosen = [(name, value) for name, value in found if value]
        figure, axes = plt.subplots(figsize=(7, 0.3 * len(chosen) + 0.8))
        names, values = zip(*chosen, strict=True)
        alone = not any(map(is_ours, names))
        axes.barh(names, values, color=[OURS if alone or is_ours(name) else PEERS for name in names])
        axes.invert_yaxis()
        if max(values) > _FAR_APART * min(values):  # where bars do not start at zero, their lengths say little
            axes.set_xscale("log")
        axes.set_xlabel(label)
        axes.grid(axis="x", alpha=0.3)
        return figure

    return draw


def is_ours(name: str) -> bool:
    """Whether a row is upslope's own."""
    return any(word in name for word in ("upslope", "Potential", "Φ"))


def growth(content: Any) -> Any:
    """Time against size, all series on one logarithmic plot, with a line of exponent one."""
    figure, axes = plt.subplots(figsize=(6, 4))
    for series in content["fits"]:
        points = [(name, row) for name, row in content["rows"].items() if name.startswith(f"{series}: ")]
        sizes = [float(name.split(": ")[1].replace(",", "")) for name, _ in points]
        medians = [row["median"] for _, row in points]
        spans = np.abs(np.array([[row["fastest"], row["slowest"]] for _, row in points]).T - medians)
        exponent = content["fits"][series]["exponent"]
        axes.errorbar(sizes, medians, yerr=spans, marker="o", capsize=2, label=f"{series}, exponent {exponent:.2f}")
    sizes = np.array([1.0, 1000.0])
    axes.plot(sizes, 1e-3 * sizes, color="black", linestyle=":", label="exponent 1")
    _logarithmic(axes, "how many", "seconds an iteration")
    return figure


def throughput(content: Any) -> Any:
    """Steps per second against width, a panel for each level."""
    levels = ("alone", "with a policy", "with training")
    figure, panels = plt.subplots(1, 3, figsize=(13, 4), sharey=True)
    lines: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for name, row in content["rows"].items():
        *who, width, level = name.split(", ")
        if level not in levels:
            continue  # a part of a step only
        lines.setdefault((", ".join(who), level), []).append((float(width.replace(",", "")), row["steps/s"]))
    for axes, level in zip(panels, levels, strict=True):
        for (who, at), points in lines.items():
            if at == level:
                style = "-" if is_ours(who) else "--"
                axes.plot(*zip(*points, strict=True), style, marker="o", label=who)
        axes.set_title(level)
        _logarithmic(axes, "environments", "steps per second" if axes is panels[0] else "", legend=False)
    # The first panel has all of them, those that are timed alone only too.
    panels[-1].legend(*panels[0].get_legend_handles_labels(), fontsize=8, bbox_to_anchor=(1.02, 1), loc="upper left")
    return figure


def shares(content: Any) -> Any:
    """A stacked bar for each job."""
    jobs: dict[str, list[tuple[str, float]]] = {}
    for name, row in content["rows"].items():
        job, phase = name.split(": ")
        jobs.setdefault(job, []).append((phase, max(row["share, %"], 0.0)))
    figure, axes = plt.subplots(figsize=(9, 0.7 * len(jobs) + 0.8))
    for job, phases in jobs.items():
        left = 0.0
        for index, (phase, share) in enumerate(phases):
            axes.barh(job, share, left=left, color=plt.get_cmap("tab10")(index), alpha=0.8)
            if share > 8:
                axes.text(left + share / 2, job, phase.replace(", ", ",\n"), ha="center", va="center", fontsize=6)
            left += share
    axes.invert_yaxis()
    axes.set_xlabel("share of a step, %")
    return figure


def _logarithmic(axes: Axes, x: str, y: str, *, legend: bool = True) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    if legend:
        axes.legend(fontsize=8)


_DRAWN: dict[str, Callable[[Any], Any]] = {
    "meta_training": bars_of(
        lambda _, row: row.get("s a seed") or row.get("s a seed, extrapolated") or row["median"], "seconds a seed"
    ),
    "shaping": bars_of(lambda _, row: row.get("learner-updates/s"), "learner-updates per second"),
    "environments": throughput,
    "wrapper": bars_of(lambda _, row: row["median"], "microseconds a step"),
    "meta_gradient": bars_of(lambda _, row: row["median"], "seconds"),
    "scaling": growth,
    "memory": bars_of(lambda _, row: row["median"], "MiB over the imports"),
    "devices": bars_of(lambda _, row: row["median"], "seconds"),
    "profile": shares,
}
