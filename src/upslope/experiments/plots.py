"""The pictures of a figure."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from upslope.experiments.experiment import PANELS
from upslope.experiments.results import Arm, FigureResult, Panel, Score
from upslope.experiments.statistics import quartiles
from upslope.storage import write_atomically

#: Label, colour and line of each arm; dashed arms are references, dotted ones are not policy-invariant.
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
    """Writes figure.png and figure.pdf: a row of panels, and a row that shows how the left one depends on the prior.

    If panels are pending, only figure.png is written, with room left for them.

    Raises:
        NotSavedError: the disk is full, or the folder is missing or read-only; an older picture stays intact.
    """
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = _figure(result)
        for kind in ("png",) if result.pending else ("png", "pdf"):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=150)
            write_atomically(folder / f"figure.{kind}", buffer.getvalue())
        plt.close(figure)


def _figure(result: FigureResult) -> Figure:
    names = [name for name in PANELS if name in result.panels or name in result.pending]
    has_left = "left" in names
    has_discounted = all(
        "discounted_return" in arm.others for panel in result.panels.values() for arm in panel.arms.values()
    )
    rows = 1 + has_left + has_discounted
    size = (5.2 * len(names), 4.5 * rows)
    figure, axes = plt.subplots(rows, len(names), figsize=size, squeeze=False, layout="constrained")
    for axis in axes.ravel():
        axis.axis("off")
    for column, name in enumerate(names):
        if name not in result.panels:
            axes[0, column].text(0.5, 0.5, f"the {name} panel is not finished", ha="center", color="#878787")
            continue
        draw_panel(_make_visible(axes[0, column]), result.panels[name])
        if has_discounted:
            draw_discounted(_make_visible(axes[-1, column]), result.panels[name])
    if has_left:
        about_left = (draw_training, _draw_gains, _draw_steadiness) if "left" in result.panels else (draw_training,)
        for axis, draw_one in zip(axes[1], about_left, strict=False):
            draw_one(_make_visible(axis), result)
    warnings = ["Not finished yet"] if result.pending else []
    if result.quick:
        warnings.append("Quick form: too few seeds, tasks and updates to say anything about the paper")
    if warnings:
        figure.suptitle("\n".join(warnings), color="#b2182b")
    return figure


def _make_visible(axis: Axes) -> Axes:
    axis.axis("on")
    return axis


def _draw_gains(axis: Axes, result: FigureResult) -> None:
    panel = result.panels["left"]
    draw_starts(axis, panel, _gain)
    label = f"mean {panel.score.name} over updates − {panel.score.name} before"
    axis.set(title="Adaptation by the age of the prior", ylabel=label)


def _draw_steadiness(axis: Axes, result: FigureResult) -> None:
    draw_starts(axis, result.panels["left"], _late_lower_quartile)
    axis.set(title="Steadiness by the age of the prior", ylabel="lower quartile of the last five updates")


def draw_panel(axis: Axes, panel: Panel) -> None:
    """All arms over their updates: medians and quartiles, or interquartile means and their 95 % intervals."""
    _draw_curves(axis, panel, panel.score.name, lambda arm: arm.summary)
    axis.set_ylim(_limits(panel.score))


def draw_discounted(axis: Axes, panel: Panel) -> None:
    """Discounted returns, which distinguish short paths from long ones, summarised like the panel's scores."""
    _draw_curves(axis, panel, "discounted return", lambda arm: arm.summary["discounted_return"])
    axis.set_ylim(bottom=0)


def _draw_curves(axis: Axes, panel: Panel, name: str, curves: Callable[[Arm], dict[str, Any]]) -> None:
    middle, low, high = _BANDS[panel.score.curves]
    for arm_name, arm in panel.arms.items():
        _draw_curve(axis, arm_name, arm.updates, *(curves(arm)[line] for line in (middle, low, high)))
    spread = "median, quartiles" if middle == "median" else "interquartile mean, 95 %"
    axis.set(title=panel.title, xlabel="updates", ylabel=f"{name} ({spread})")
    _legend(axis)


def _legend(axis: Axes) -> None:
    """Below the axes: inside them it would cover some curve."""
    narrow: dict[str, Any] = {"columnspacing": 1.2, "handlelength": 1.6, "handletextpad": 0.6}
    axis.legend(frameon=False, fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, **narrow)


_BANDS = {"median": ("median", "q1", "q3"), "iqm": ("iqm", "iqm_low", "iqm_high")}


def _draw_curve(axis: Axes, name: str, updates: np.ndarray, middle: list, low: list, high: list) -> None:
    label, colour, line = STYLES[name]
    axis.plot(updates, middle, line, color=colour, label=label, linewidth=1.6)
    axis.fill_between(updates, low, high, color=colour, alpha=0.10, linewidth=0)


def _limits(score: Score) -> tuple[float, float]:
    return 0.0, 1.03 * score.maximum


def draw_training(axis: Axes, result: FigureResult) -> None:
    """The prior during its training: zero-shot return on extra training tasks, one line per seed."""
    score = next(iter(result.panels.values())).score
    iterations = np.asarray(result.training["iterations"])
    returns = np.asarray(result.training["returns"])
    axis.plot(iterations, returns.T, color="#b2182b", alpha=0.35, linewidth=0.9)
    axis.plot(iterations, np.median(returns, axis=0), color="#b2182b", linewidth=1.8, label="median of the seeds")
    axis.set(
        title="The prior during its training",
        xlabel="meta-iterations",
        ylabel=f"zero-shot {score.name}",
        ylim=_limits(score),
    )
    _legend(axis)


def draw_starts(axis: Axes, panel: Panel, measure: Callable[[Arm], float]) -> None:
    """A measure of every arm against the training time of the prior that it started from."""
    stops = [int(stop) for stop in panel.variants]
    for name in panel.arms:
        label, colour, line = STYLES[name]
        heights = [measure(arms[name]) for arms in panel.variants.values()]
        axis.plot(stops, heights, line, color=colour, marker="o", markersize=3, label=label, linewidth=1.4)
    axis.set(xlabel="Algorithm 1 stopped at iteration")
    _legend(axis)


def _gain(arm: Arm) -> float:
    return float(np.mean(arm.returns[..., 1:]) - np.mean(arm.returns[..., 0]))


def _late_lower_quartile(arm: Arm) -> float:
    return float(np.mean(quartiles(arm.returns).q1[-5:]))
