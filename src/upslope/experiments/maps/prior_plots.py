"""The picture of grid priors over their training."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

TITLES = {
    "rank_correlation": "rank correlation of V with V*",
    "action_optimality": "greedy actions that are optimal",
    "success": "zero-shot success",
    "squared_error": "mean squared error of V",
    "td_residual": "TD residual",
}


def draw_grid_priors(results: dict[str, Any], aims: dict[str, float], folder: Path) -> None:
    """Writes figure.png and figure.pdf: every measure, mean over unseen maps and seeds, against iterations.

    All readings' iterations cost nearly the same, and seconds are those of whatever else a machine did.
    """
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(1, len(TITLES), figsize=(3.4 * len(TITLES), 3.2), layout="constrained")
        for axis, (measure, title) in zip(axes, TITLES.items(), strict=True):
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
