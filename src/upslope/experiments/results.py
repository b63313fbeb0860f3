"""Results as data: the curves of arms, panels and figures, written as returns.npz and results.json."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from upslope.experiments.statistics import bootstrap, first_at_least, paired_difference, quartiles
from upslope.run.compiling import CompileClock
from upslope.run.machine import hardware, versions
from upslope.storage import write_atomically


@dataclass(frozen=True)
class Score:
    """The meaning of a figure's returns.

    Attributes:
        name: what a return is called.
        maximum: the maximum return.
        goals: thresholds for the median, by name.
        digits: digits after the point in tables.
        curves: what panels show: medians and quartiles, or interquartile means, for scores that are 0 or 1.
    """

    name: str
    maximum: float
    goals: dict[str, float]
    digits: int
    curves: Literal["median", "iqm"]


#: Poles: steps until the pole fell, at most 200.
EPISODE_LENGTH = Score("return", 200.0, {"195": 195.0, "200": 200.0}, 0, "median")

#: Maps: 1 where the greedy policy reaches the goal within an episode. A median of 1 means that most maps are solved.
SUCCESS = Score("success", 1.0, {"solved": 1.0}, 2, "iqm")


@dataclass(frozen=True)
class Arm:
    """One method in a comparison.

    Attributes:
        updates: the number of updates before each evaluation ``[evaluations]``.
        returns: raw greedy returns ``[seeds, tasks, evaluations]``.
        notes: what was selected for this arm, such as its step size.
        score: the meaning of the returns.
        others: further measures by name, with the shape of the returns.
    """

    updates: np.ndarray
    returns: Float[np.ndarray, "seeds tasks evaluations"]
    notes: dict[str, Any] = field(default_factory=dict)
    score: Score = EPISODE_LENGTH
    others: dict[str, Float[np.ndarray, "seeds tasks evaluations"]] = field(default_factory=dict)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The curves and numbers of results.json."""
        curves = _curves(self.returns)
        goals = {
            f"first_median_{name}": first_at_least(self.updates, np.asarray(curves["median"]), goal)
            for name, goal in self.score.goals.items()
        }
        others = {name: _curves(values) for name, values in self.others.items()}
        return {"updates": self.updates.tolist(), **curves, **goals, **self.notes, **others}


def differences(arms: dict[str, Arm], name: str) -> dict[str, dict[str, float]]:
    """One arm's mean over all evaluations minus that of each other arm; empty if the arm does not exist."""
    if name not in arms:
        return {}
    ours = arms[name].returns
    others = {other: arm.returns for other, arm in arms.items() if other != name}
    return {other: paired_difference(ours, returns)._asdict() for other, returns in others.items()}


def make_arm(updates: np.ndarray, reports: dict[str, Any], score: Score, notes: dict[str, Any] | None = None) -> Arm:
    """An arm from its learners' reports, by name ``[seeds, tasks, evaluations]``."""
    measures = {name: np.asarray(values) for name, values in reports.items()}
    return Arm(updates, measures.pop("return"), notes or {}, score, measures)


def _curves(values: Float[np.ndarray, "seeds tasks evaluations"]) -> dict[str, Any]:
    """Statistics over all runs, at each evaluation and over all evaluations."""
    middle, interval = quartiles(values), bootstrap(values)
    of_runs = bootstrap(values.mean(axis=-1, keepdims=True))
    return {
        "median": middle.median.tolist(),
        "q1": middle.q1.tolist(),
        "q3": middle.q3.tolist(),
        "iqm": interval.iqm.tolist(),
        "iqm_low": interval.low.tolist(),
        "iqm_high": interval.high.tolist(),
        "mean_over_evaluations": float(values.mean()),
        "iqm_of_means": [float(bound[0]) for bound in (of_runs.iqm, of_runs.low, of_runs.high)],
    }


@dataclass(frozen=True)
class Panel:
    """One comparison.

    Attributes:
        title: the title of the panel.
        arms: the arms by name.
        seconds_compiling: compile time of all arms.
        seconds_running: running time of all arms.
        variants: the same comparison under other conditions, by name, such as with other starting priors.
        notes: further results of the whole panel.
    """

    title: str
    arms: dict[str, Arm]
    seconds_compiling: float
    seconds_running: float
    variants: dict[str, dict[str, Arm]] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def score(self) -> Score:
        """The meaning of the returns of all arms."""
        return next(iter(self.arms.values())).score


@dataclass(frozen=True)
class FigureResult:
    """Everything that a figure's picture and report are made from.

    Attributes:
        name: the name of the figure, by which its wording is looked up.
        panels: the panels by name.
        priors: one row per seed.
        training: ``iterations`` and ``returns`` of the meta-training.
        configuration: all settings.
        quick: whether this is the quick form, which says nothing about the paper.
        seconds_compiling: compile time of the whole figure.
        seconds_running: running time of the whole figure.
        pending: names of the panels that are not finished; empty at the end.
    """

    name: str
    panels: dict[str, Panel]
    priors: list[dict[str, int | float]]
    training: dict[str, Any]
    configuration: dict[str, Any]
    quick: bool
    seconds_compiling: float
    seconds_running: float
    pending: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The content of results.json."""
        return {
            "figure": self.name,
            "quick": self.quick,
            "panels": {name: _panel_json(panel) for name, panel in self.panels.items()},
            "priors": self.priors,
            "training": self.training,
            "seconds_compiling": self.seconds_compiling,
            "seconds_running": self.seconds_running,
            "versions": versions(),
            "hardware": hardware(),
            "configuration": self.configuration,
        }


def provenance(clock: CompileClock, configuration: dict[str, Any]) -> dict[str, Any]:
    """The last entries of every results.json: times, versions, hardware and all settings."""
    return {
        "seconds_compiling": clock.seconds,
        "seconds_running": clock.seconds_running,
        "versions": versions(),
        "hardware": hardware(),
        "configuration": configuration,
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Writes one file of results atomically.

    Raises:
        NotSavedError: the disk is full, or the folder is missing or read-only.
    """
    write_atomically(path, (json.dumps(content, indent=1, default=_plain) + "\n").encode())


def write_results(result: FigureResult, folder: Path) -> None:
    """Writes returns.npz (``panel/arm`` to ``[seed, task, evaluation]``) and results.json."""
    arrays = {}
    for panel_name, panel in result.panels.items():
        for arm_name, arm in panel.arms.items():
            arrays[f"{panel_name}/{arm_name}"] = arm.returns
            arrays |= {f"{panel_name}/{arm_name}/{name}": values for name, values in arm.others.items()}
        for variant, arms in panel.variants.items():
            arrays |= {f"{panel_name}@{variant}/{name}": arm.returns for name, arm in arms.items()}
    np.savez_compressed(folder / "returns.npz", allow_pickle=False, **arrays)
    write_json(folder / "results.json", result.as_json())


def _panel_json(panel: Panel) -> dict[str, Any]:
    entry = {
        "title": panel.title,
        "arms": {name: arm.summary for name, arm in panel.arms.items()},
        "seconds_compiling": panel.seconds_compiling,
        "seconds_running": panel.seconds_running,
        **panel.notes,
    }
    if panel.variants:
        entry["variants"] = {
            variant: {name: arm.summary for name, arm in arms.items()} for variant, arms in panel.variants.items()
        }
    return entry


def _plain(value: Any) -> Any:
    """Numpy scalars and arrays as plain numbers and lists."""
    return np.asarray(value).tolist()
