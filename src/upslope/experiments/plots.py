"""The pictures of a figure."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from upslope.experiments.results import Arm, FigureResult, Panel

#: What each arm is called and drawn with; dashed arms are references, dotted ones are not policy-invariant.
STYLES: dict[str, tuple[str, str, str]] = {
    "unshaped": ("no shaping", "#4d9221", "-"),
    "constant": ("constant potential", "#878787", "-"),
    "prior": ("meta-learned prior", "#d6604d", "-"),
    "prior_ensemble": ("mean of the priors", "#b2182b", "-"),
    "prior_unzeroed": ("prior, not policy-invariant", "#f4a582", ":"),
    "oracle": ("oracle", "#2166ac", "--"),
    "algorithm2": ("Algorithm 2", "#b2182b", "-"),
    "algorithm2_raw": ("Algorithm 2, raw A", "#f4a582", "-"),
    "frozen_potential": ("V frozen, two A steps", "#762a83", "--"),
    "td_centred": ("TD on V + A − frozen max A", "#878787", "--"),
    "maml": ("MAML", "#4d9221", "-"),
    "maml_two_steps": ("MAML, two steps", "#a6dba0", "-"),
}


def draw(result: FigureResult, folder: Path) -> None:
    """Writes figure.png and figure.pdf: one row of panels, and one of how the left panel depends on the prior."""
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = _figure(result)
        figure.savefig(folder / "figure.png", dpi=150)
        figure.savefig(folder / "figure.pdf")
        plt.close(figure)


def _figure(result: FigureResult) -> Figure:
    count = len(result.panels)
    second_row = "left" in result.panels
    figure, axes = plt.subplots(
        1 + second_row, count, figsize=(5.2 * count, 4.2 * (1 + second_row)), squeeze=False, layout="constrained"
    )
    for axis, panel in zip(axes[0], result.panels.values(), strict=True):
        draw_panel(axis, panel)
    if second_row:
        draw_training(axes[1, 0], result)
        for axis in axes[1, 1:]:
            axis.axis("off")
        if count > 1:
            axes[1, 1].axis("on")
            draw_starts(axes[1, 1], result.panels["left"], _gain)
            axes[1, 1].set(
                title="Adaptation by the age of the prior", ylabel="mean return over updates − return before"
            )
        if count > 2:
            axes[1, 2].axis("on")
            draw_starts(axes[1, 2], result.panels["left"], _late_lower_quartile)
            axes[1, 2].set(title="Steadiness by the age of the prior", ylabel="lower quartile of the last five updates")
    if result.quick:
        figure.suptitle("Quick form: too few seeds, tasks and updates to say anything about the paper", color="#b2182b")
    return figure


def draw_panel(axis: Axes, panel: Panel) -> None:
    """Median returns over seeds and tasks, with the quartiles shaded."""
    for name, arm in panel.arms.items():
        label, colour, line = STYLES[name]
        summary = arm.summary
        axis.plot(arm.updates, summary["median"], line, color=colour, label=label, linewidth=1.6)
        axis.fill_between(arm.updates, summary["q1"], summary["q3"], color=colour, alpha=0.10, linewidth=0)
    axis.set(title=panel.title, xlabel="updates", ylabel="return (median, quartiles)", ylim=(0, 206))
    axis.legend(frameon=False, fontsize=7, loc="lower right")


def draw_training(axis: Axes, result: FigureResult) -> None:
    """The prior over its training: zero-shot return on extra training tasks, a line per seed."""
    iterations = np.asarray(result.training["iterations"])
    returns = np.asarray(result.training["returns"])
    axis.plot(iterations, returns.T, color="#b2182b", alpha=0.35, linewidth=0.9)
    axis.plot(iterations, np.median(returns, axis=0), color="#b2182b", linewidth=1.8, label="median of the seeds")
    axis.set(title="The prior over its training", xlabel="meta-iterations", ylabel="zero-shot return", ylim=(0, 206))
    axis.legend(frameon=False, fontsize=7, loc="lower right")


def draw_starts(axis: Axes, panel: Panel, measure: Callable[[Arm], float]) -> None:
    """A measure of every arm against how long the prior that it started from was trained."""
    stops = [int(stop) for stop in panel.variants]
    for name in panel.arms:
        label, colour, line = STYLES[name]
        heights = [measure(arms[name]) for arms in panel.variants.values()]
        axis.plot(stops, heights, line, color=colour, marker="o", markersize=3, label=label, linewidth=1.4)
    axis.set(xlabel="Algorithm 1 stopped at iteration")
    axis.legend(frameon=False, fontsize=7)


def _gain(arm: Arm) -> float:
    return float(np.mean(arm.returns[..., 1:]) - np.mean(arm.returns[..., 0]))


def _late_lower_quartile(arm: Arm) -> float:
    return float(np.mean(arm.summary["q1"][-5:]))
