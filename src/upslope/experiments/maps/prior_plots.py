"""The picture of grid priors over their training."""

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


def draw_grid_priors(results: dict[str, Any], aims: dict[str, float], folder: Path) -> None:
    """Writes figure.png and figure.pdf: every measure, mean over unseen maps and seeds, against iterations.

    All readings' iterations cost nearly the same, and seconds are those of whatever else a machine did. Bands go from
    the lowest to the highest seed. The last panel shows the single maps, where they ask for detours.
    """
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        columns = len(TITLES) + any(results["detours"])
        figure, axes = plt.subplots(1, columns, figsize=(3.4 * columns, 3.2), layout="constrained")
        if any(results["detours"]):
            _draw_detours(results, axes[-1])
        for axis, (measure, title) in zip(axes[: len(TITLES)], TITLES.items(), strict=True):
            for row in results["readings"].values():
                seeds = np.asarray(row["measures"][measure]["mean"])
                (line,) = axis.plot(row["iterations"], seeds.mean(axis=0), label=row["what"], linewidth=1.5)
                axis.fill_between(
                    row["iterations"],
                    seeds.min(axis=0),
                    seeds.max(axis=0),
                    color=line.get_color(),
                    alpha=0.2,
                    linewidth=0,
                )
            if measure in aims:
                axis.axhline(aims[measure], color="#878787", linewidth=0.8, linestyle="--")
                axis.set_ylim(min(0.0, axis.get_ylim()[0]), 1.02)
            else:
                axis.set_yscale("log")
            axis.set(title=title, xlabel="iterations")
        axes[0].legend(frameon=False, fontsize=7, loc="lower right")
        figure.savefig(folder / "figure.png", dpi=150)
        figure.savefig(folder / "figure.pdf")
        plt.close(figure)


def _draw_detours(results: dict[str, Any], axis: Axes) -> None:
    """What limits a prior: the more a map's walls stand in the way, the less its V is in order."""
    for row in results["readings"].values():
        correlation = np.mean(row["maps"]["rank_correlation"], axis=0)
        axis.scatter(results["detours"], correlation, s=8, alpha=0.6, linewidth=0)
    axis.set(title="single maps", xlabel="mean detour, steps", ylabel="rank correlation of V with V*")
