"""The picture of a verdict: returns by task, V against what it predicts, and learners with and without shaping."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from upslope.evaluation.learner_test import LearnerTest
from upslope.evaluation.signs import Signs
from upslope.evaluation.verdict import Verdict
from upslope.storage import write_atomically

#: Label, colour and line of each arm. Arms that learn nothing lie on one another: the dashed one comes last.
STYLES = {
    "shaped": ("this prior", "#d6604d", "-"),
    "constant": ("constant potential", "#878787", "-"),
    "unshaped": ("no shaping", "#4d9221", "--"),
}


def draw(verdict: Verdict, path: Path) -> None:
    """Writes the picture as a PNG file.

    Raises:
        NotSavedError: the disk is full, or the folder is missing or read-only; an older picture stays intact.
    """
    panels = 2 if verdict.test is None else 3
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(1, panels, figsize=(4 * panels, 3.4), layout="constrained")
        _returns(axes[0], verdict.signs)
        _calibration(axes[1], verdict.signs)
        if verdict.test is not None:
            _learners(axes[2], verdict.test)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=150)
        plt.close(figure)
    write_atomically(path, buffer.getvalue())


def _returns(axis: Axes, signs: Signs) -> None:
    order = np.argsort(signs.greedy)
    places = np.arange(1, len(order) + 1)
    axis.plot(places, signs.greedy[order], "o", color="#d6604d", markersize=4, label="greedy policy")
    axis.plot(places, signs.random[order], "x", color="#878787", markersize=4, label="random actions")
    axis.set(title="Return on each fresh task", xlabel="task, from worst to best", ylabel="return")
    axis.legend(frameon=False)


def _calibration(axis: Axes, signs: Signs) -> None:
    ends = [min(signs.start_value.min(), signs.discounted.min()), max(signs.start_value.max(), signs.discounted.max())]
    axis.plot(ends, ends, color="#878787", linewidth=0.8)
    axis.plot(signs.discounted, signs.start_value, "o", color="#2166ac", markersize=4)
    axis.set(title="Is V right?", xlabel="discounted return of the greedy policy", ylabel="V of the first state")


def _learners(axis: Axes, test: LearnerTest) -> None:
    for arm, (label, colour, line) in STYLES.items():
        low, middle, high = np.percentile(test.returns[arm], [25, 50, 75], axis=0)
        axis.fill_between(test.updates, low, high, color=colour, alpha=0.15, linewidth=0)
        axis.plot(test.updates, middle, line, color=colour, label=label)
    title = f"{test.learner.upper()} on {len(test.returns['shaped'])} fresh tasks"
    axis.set(title=title, xlabel="updates", ylabel="return: median and quartiles")
    axis.legend(frameon=False)
