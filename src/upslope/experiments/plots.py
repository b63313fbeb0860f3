"""The pictures of a figure."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from upslope.experiments.results import Arm, FigureResult, Panel, Score

#: What each arm is called and drawn with; dashed arms are references, dotted ones are not policy-invariant.
STYLES: dict[str, tuple[str, str, str]] = {
    "unshaped": ("no shaping", "#4d9221", "-"),
    "constant": ("constant potential", "#878787", "-"),
    "prior": ("meta-learned prior", "#d6604d", "-"),
    "prior_ensemble": ("mean of the priors", "#b2182b", "-"),
    "prior_unzeroed": ("prior, not policy-invariant", "#f4a582", ":"),
    "multi_task_dqn": ("prior of multi-task DQN", "#8c510a", "-"),
    "manhattan": ("Manhattan distance", "#762a83", "--"),
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
    has_left = "left" in result.panels
    has_discounted = all(
        "discounted_return" in arm.others for panel in result.panels.values() for arm in panel.arms.values()
    )
    rows = 1 + has_left + has_discounted
    figure, axes = plt.subplots(rows, count, figsize=(5.2 * count, 4.2 * rows), squeeze=False, layout="constrained")
    for axis, panel in zip(axes[0], result.panels.values(), strict=True):
        draw_panel(axis, panel)
    if has_discounted:
        for axis, panel in zip(axes[-1], result.panels.values(), strict=True):
            draw_discounted(axis, panel)
    if has_left:
        for axis in axes[1]:
            axis.axis("off")
        for axis, draw_one in zip(axes[1], (draw_training, _draw_gains, _draw_steadiness), strict=False):
            axis.axis("on")
            draw_one(axis, result)
    if result.quick:
        figure.suptitle("Quick form: too few seeds, tasks and updates to say anything about the paper", color="#b2182b")
    return figure


def _draw_gains(axis: Axes, result: FigureResult) -> None:
    panel = result.panels["left"]
    draw_starts(axis, panel, _gain)
    label = f"mean {panel.score.name} over updates − {panel.score.name} before"
    axis.set(title="Adaptation by the age of the prior", ylabel=label)


def _draw_steadiness(axis: Axes, result: FigureResult) -> None:
    draw_starts(axis, result.panels["left"], _late_lower_quartile)
    axis.set(title="Steadiness by the age of the prior", ylabel="lower quartile of the last five updates")


def draw_panel(axis: Axes, panel: Panel) -> None:
    """Every arm over its updates: medians with the quartiles shaded, or interquartile means with their intervals."""
    middle, low, high = _BANDS[panel.score.curves]
    for name, arm in panel.arms.items():
        _draw_curve(axis, name, arm.updates, *(arm.summary[line] for line in (middle, low, high)))
    spread = "median, quartiles" if middle == "median" else "interquartile mean, 95 %"
    axis.set(title=panel.title, xlabel="updates", ylabel=f"{panel.score.name} ({spread})", ylim=_limits(panel.score))
    axis.legend(frameon=False, fontsize=7, loc="lower right")


def draw_discounted(axis: Axes, panel: Panel) -> None:
    """Discounted returns, which tell short ways from long ones: medians with the quartiles shaded."""
    for name, arm in panel.arms.items():
        curves = arm.summary["discounted_return"]
        _draw_curve(axis, name, arm.updates, curves["median"], curves["q1"], curves["q3"])
    axis.set(title=panel.title, xlabel="updates", ylabel="discounted return (median, quartiles)", ylim=(0, 1.03))


_BANDS = {"median": ("median", "q1", "q3"), "iqm": ("iqm", "iqm_low", "iqm_high")}


def _draw_curve(axis: Axes, name: str, updates: np.ndarray, middle: list, low: list, high: list) -> None:
    label, colour, line = STYLES[name]
    axis.plot(updates, middle, line, color=colour, label=label, linewidth=1.6)
    axis.fill_between(updates, low, high, color=colour, alpha=0.10, linewidth=0)


def _limits(score: Score) -> tuple[float, float]:
    return 0.0, 1.03 * score.top


def draw_training(axis: Axes, result: FigureResult) -> None:
    """The prior over its training: zero-shot return on extra training tasks, a line per seed."""
    score = next(iter(result.panels.values())).score
    iterations = np.asarray(result.training["iterations"])
    returns = np.asarray(result.training["returns"])
    axis.plot(iterations, returns.T, color="#b2182b", alpha=0.35, linewidth=0.9)
    axis.plot(iterations, np.median(returns, axis=0), color="#b2182b", linewidth=1.8, label="median of the seeds")
    axis.set(
        title="The prior over its training",
        xlabel="meta-iterations",
        ylabel=f"zero-shot {score.name}",
        ylim=_limits(score),
    )
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
