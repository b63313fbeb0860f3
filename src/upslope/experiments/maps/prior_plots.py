"""The picture of grid priors during their training."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

TITLES = {
    "rank_correlation": "rank correlation of V with V*",
    "action_optimality": "greedy actions that are optimal",
    "success": "zero-shot success",
    "squared_error": "mean squared error of V",
    "td_residual": "TD residual",
}

#: With at most this many readings there is room for a legend inside a panel, and for a panel of single maps.
_FEW = 3


def draw_grid_priors(results: dict[str, Any], aims: dict[str, float], folder: Path) -> None:
    """Writes figure.png and figure.pdf: every measure during training, as a mean over unseen maps and seeds.

    The horizontal axis is the number of iterations if it is equal for all readings. Readings that were made to take
    equal time have different numbers, and the axis is the share of each training: measured seconds depend on what else
    the machine did. Bands go from the lowest to the highest seed. With few readings the last panel shows single maps
    against their detours.
    """
    rows = list(results["readings"].values())
    lengths = {row["iterations"][-1] for row in rows}
    detours = any(results["detours"]) and len(rows) <= _FEW
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        columns = len(TITLES) + detours
        figure, axes = plt.subplots(1, columns, figsize=(3.4 * columns, 3.2), layout="constrained")
        if detours:
            _draw_detours(results, axes[-1])
        for axis, (measure, title) in zip(axes[: len(TITLES)], TITLES.items(), strict=True):
            for number, row in enumerate(rows):
                seeds = np.asarray(row["measures"][measure]["mean"])
                progress = np.asarray(row["iterations"]) / (1 if len(lengths) == 1 else row["iterations"][-1])
                style = {"color": f"C{number % 10}", "linestyle": "-" if number < 10 else "--"}
                axis.plot(progress, seeds.mean(axis=0), label=row["what"], linewidth=1.5, **style)
                axis.fill_between(
                    progress, seeds.min(axis=0), seeds.max(axis=0), color=style["color"], alpha=0.15, linewidth=0
                )
            if measure in aims:
                axis.axhline(aims[measure], color="#878787", linewidth=0.8, linestyle="--")
                axis.set_ylim(min(0.0, axis.get_ylim()[0]), 1.02)
            else:
                axis.set_yscale("log")
            axis.set(title=title, xlabel="iterations" if len(lengths) == 1 else "share of the training (equal time)")
        if len(rows) <= _FEW:
            axes[0].legend(frameon=False, fontsize=7, loc="lower right")
        else:
            figure.legend(*axes[0].get_legend_handles_labels(), frameon=False, ncols=6, loc="outside lower center")
        figure.savefig(folder / "figure.png", dpi=150)
        figure.savefig(folder / "figure.pdf")
        plt.close(figure)


def _draw_detours(results: dict[str, Any], axis: Axes) -> None:
    """What limits a prior: the longer the detours of a map, the lower the rank correlation of V."""
    for row in results["readings"].values():
        correlation = np.mean(row["maps"]["rank_correlation"], axis=0)
        axis.scatter(results["detours"], correlation, s=8, alpha=0.6, linewidth=0)
    axis.set(title="single maps", xlabel="mean detour, steps", ylabel="rank correlation of V with V*")
