"""The picture of the theorems: what violates policy invariance, how good Φ must be, when Eqs. 8 and 9 converge."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

#: The kind of maps in the first and the third panel.
SHOWN = "obstacles 8×8"
COLOURS = ("#b2182b", "#2166ac", "#4d9221", "#762a83")


def draw_theorems(results: dict[str, Any], folder: Path) -> None:
    """Writes figure.png and figure.pdf."""
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(2, 2, figsize=(11.5, 8.4), layout="constrained")
        draw_invariance(axes[0, 0], results["invariance"][SHOWN])
        draw_noise(axes[0, 1], results["credit"])
        draw_tables(axes[1, 0], results["alternation"][SHOWN])
        draw_network(axes[1, 1], results["network"])
        figure.savefig(folder / "figure.png", dpi=150)
        figure.savefig(folder / "figure.pdf")
        plt.close(figure)


def draw_invariance(axis: Axes, rows: dict[str, dict[str, dict[str, float]]]) -> None:
    """Thm. 2.1: the share of maps in which some optimal action changes, by potential and by what is added."""
    added = list(next(iter(rows.values())))
    shares = np.array([[100 * row[name]["changed"] for row in rows.values()] for name in added])
    axis.imshow(shares, cmap="Reds", vmin=0, vmax=120, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        axis.text(column, row, f"{share:.0f} %", ha="center", va="center", color="white" if share > 60 else "black")
    axis.set_xticks(range(len(rows)), [f"Φ {name}" for name in rows])
    axis.set_yticks(range(len(added)), added)
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    axis.set_title(f"Thm. 2.1: maps ({SHOWN}) whose optimal actions change")


def draw_noise(axis: Axes, rows: dict[str, dict[str, Any]]) -> None:
    """Thm. 3.1: maps solved by the best immediate shaped reward alone, against the noise on Φ = V*."""
    for colour, (kind, row) in zip(COLOURS, rows.items(), strict=False):
        noise = np.asarray(row["noise"])
        axis.plot(noise, row["solved_by_noise"], color=colour, marker="o", markersize=3, label=kind)
        axis.axhline(row["solved"]["Manhattan"], color=colour, linestyle=":", linewidth=1)
    ticks = (0, 0.01, 0.03, 0.1, 0.2, 0.5)
    axis.set_xscale("symlog", linthresh=0.003, linscale=0.4)
    axis.set_xticks(ticks, [f"{level:g}" for level in ticks])
    axis.minorticks_off()
    axis.set(title="Thm. 3.1: acting on the immediate reward, Φ = V* + noise", xlim=(-3e-4, 0.6), ylim=(0, 1.03))
    axis.set(xlabel="standard deviation of the noise", ylabel="share of maps solved in 50 steps")
    axis.plot([], [], color="black", linestyle=":", linewidth=1, label="Φ = γ^(Manhattan distance − 1)")
    axis.legend(frameon=False, loc="lower left")


def draw_tables(axis: Axes, row: dict[str, Any]) -> None:
    """Thm. 3.2 on tables: the distance of V to V*, median and worst map."""
    for colour, (start, curves) in zip(COLOURS, row["starts"].items(), strict=False):
        axis.plot(row["pairs"], np.maximum(curves["median"], 1e-9), color=colour, label=f"{start}, median map")
        axis.plot(
            row["pairs"], np.maximum(curves["worst"], 1e-9), color=colour, linestyle="--", label=f"{start}, worst map"
        )
    axis.set(yscale="log", ylim=(1e-9, 1e6), xlabel="pairs of steps of Eqs. 8 and 9", ylabel="largest |V − V*|")
    axis.set_title(f"Thm. 3.2 on tables ({SHOWN}); ratio of V's step to A's")
    axis.legend(frameon=False, fontsize=7)


def draw_network(axis: Axes, results: dict[str, Any]) -> None:
    """Thm. 3.2 on a network: the distance of V to V*, one line per seed."""
    for colour, (ratio, runs) in zip((COLOURS[0], COLOURS[2]), results["ratios"].items(), strict=False):
        for number, run in enumerate(runs["value"]):
            axis.plot(results["updates"], run, color=colour, linewidth=1, label=None if number else f"ratio {ratio}")
    axis.set(yscale="log", xlabel="pairs of steps of Eqs. 8 and 9", ylabel="largest |V − V*|")
    axis.set_title("Thm. 3.2 on a network (one 5×5 map, one line per seed)")
    axis.legend(frameon=False)
