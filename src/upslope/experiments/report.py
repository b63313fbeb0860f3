"""Reports of a figure: tables in the terminal, and an HTML page."""

import html
from pathlib import Path
from textwrap import fill

import numpy as np
from rich.console import Console
from rich.table import Table

from upslope.experiments.page import bullets, page, picture, table
from upslope.experiments.plots import STYLES
from upslope.experiments.results import FigureResult, Panel, Score
from upslope.experiments.wording import WORDING
from upslope.storage import write_atomically


def print_summary(result: FigureResult, console: Console) -> None:
    """Prints one table per panel, then the findings."""
    for panel in result.panels.values():
        # Narrow, for terminals of 80 characters: numbers stay whole, and names of arms break between words.
        rows = Table(title=panel.title, title_justify="left", box=None, padding=(0, 1, 0, 0))
        for column in columns(panel.score):
            rows.add_column(fill(column, 7, break_long_words=False), no_wrap=column != "arm")
        for row in panel_rows(panel):
            rows.add_row(*(cell.replace(" to ", "–") for cell in row))
        console.print(rows, "")
    for sentence in findings(result):
        console.print(f"• {sentence}", highlight=False)


def columns(score: Score) -> tuple[str, ...]:
    """The column headings of a panel's table."""
    firsts = (f"{goal} first at" for goal in score.goals)
    return ("arm", "start", "end", "lower quartile at end", "mean", "interquartile mean of runs (95 %)", *firsts)


def panel_rows(panel: Panel) -> list[tuple[str, ...]]:
    """The table of a panel: medians at the first and last evaluation, and when they first reached the goals.

    Means are over all runs and evaluations; interquartile means are over the means of the runs.
    """
    rows: list[tuple[str, ...]] = []
    digits = panel.score.digits
    for name, arm in panel.arms.items():
        summary = arm.summary
        firsts = (summary[f"first_median_{goal}"] for goal in panel.score.goals)
        rows.append(
            (
                STYLES[name][0],
                f"{summary['median'][0]:.{digits}f}",
                f"{summary['median'][-1]:.{digits}f}",
                f"{summary['q1'][-1]:.{digits}f}",
                f"{summary['mean_over_evaluations']:.{digits + 1}f}",
                _with_interval(*summary["iqm_of_means"], digits=digits + 1),
                *("never" if first is None else str(first) for first in firsts),
            )
        )
    return rows


def _with_interval(middle: float, low: float, high: float, *, digits: int) -> str:
    return "{} ({} to {})".format(*(_number(value, digits) for value in (middle, low, high)))


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−")


def findings(result: FigureResult) -> list[str]:
    """Sentences computed from the numbers."""
    sentences = [WORDING[result.name].about_priors(result.priors)]
    for panel in result.panels.values():
        sentences.append(
            _about_adaptation(panel, WORDING[result.name].paper) if panel.variants else _about_shaping(panel)
        )
        if panel.notes.get("prior_less"):
            sentences.append(_about_differences(panel, "the prior", panel.notes["prior_less"]))
        if panel.notes.get("percent_below_oracle"):
            sentences.append(_about_the_oracle(panel, **panel.notes["percent_below_oracle"]))
        if panel.variants and panel.notes.get("algorithm2_less"):
            less = panel.notes["algorithm2_less"][str(panel.notes["stop"])]
            sentences.append(_about_differences(panel, "Algorithm 2", less))
    return sentences


def _about_differences(panel: Panel, whose: str, less: dict[str, dict[str, float]]) -> str:
    gaps = [
        f"{STYLES[name][0]} {_with_interval(gap['mean'], gap['low'], gap['high'], digits=panel.score.digits + 1)}"
        for name, gap in less.items()
    ]
    return (
        f"{panel.title}: {whose}'s mean {panel.score.name} minus that of each other arm, with 95 % intervals over "
        f"tasks and seeds: {'; '.join(gaps)}."
    )


def _about_the_oracle(panel: Panel, percent: float, low: float, high: float, of_seeds: list[float]) -> str:
    each = ", ".join(_number(one, 1) for one in sorted(of_seeds))
    return (
        f"{panel.title}: with the prior, the mean {panel.score.name} is {_with_interval(percent, low, high, digits=1)} "
        f"percent below that with the oracle, over tasks and seeds; with the prior of each seed: {each}."
    )


def _about_shaping(panel: Panel) -> str:
    means = {name: float(arm.returns.mean()) for name, arm in panel.arms.items()}
    digits = panel.score.digits
    texts = {name: f"{mean:.{digits}f}" for name, mean in means.items()}
    controls = [
        f"{texts['unshaped']} without shaping{_times(means, 'unshaped')}",
        f"{texts['constant']} with a constant potential{_times(means, 'constant')}",
    ]
    others = {
        "prior_ensemble": "the mean of the priors",
        "multi_task_dqn": "the prior of multi-task DQN",
        "manhattan": "Manhattan distance",
        "oracle": "the oracle",
    }
    rest = ", ".join(f"{words} {texts[name]}" for name, words in others.items() if name in texts)
    return (
        f"{panel.title}: with the prior, the mean {panel.score.name} over all evaluations is {texts['prior']}, "
        f"compared with {' and '.join(controls)}; {rest}."
    )


def _times(means: dict[str, float], control: str) -> str:
    return f" ({means['prior'] / means[control]:.2f} times)" if means[control] > 0 else ""


def _about_adaptation(panel: Panel, paper: str) -> str:
    name, goal = list(panel.score.goals.items())[-1]
    digits = panel.score.digits
    ours, theirs = panel.arms["algorithm2"].summary, panel.arms["maml"].summary
    first, other = ours[f"first_median_{name}"], theirs[f"first_median_{name}"]
    if first is None and other is None:
        speed = f"neither Algorithm 2 nor MAML reaches a median of {goal:.0f}"
    else:
        our_update, their_update = ("never" if update is None else str(update) for update in (first, other))
        speed = (
            f"updates until the median first reaches {goal:.0f}: {our_update} with Algorithm 2, {their_update} with "
            f"MAML{paper}"
        )
    return (
        f"{panel.title}: {speed}; lower quartile at the end {ours['q1'][-1]:.{digits}f} and "
        f"{theirs['q1'][-1]:.{digits}f}, mean over updates {ours['mean_over_evaluations']:.{digits}f} and "
        f"{theirs['mean_over_evaluations']:.{digits}f}."
    )


def write_report(result: FigureResult, folder: Path) -> None:
    """Writes report.html: the findings, the picture and the tables, in one file.

    Raises:
        NotSavedError: the disk is full, or the folder is missing or read-only.
    """
    panels = list(result.panels.values())
    digits = panels[0].score.digits + 1
    seeds, tasks = next(iter(panels[0].arms.values())).returns.shape[:2]
    words = WORDING[result.name]
    means = [row["zero_shot_mean"] for row in result.priors]
    parts = [
        f"<p>{words.intro.format(seeds=seeds, tasks=tasks)}</p>",
        bullets(findings(result)),
        picture(folder / "figure.png", words.title),
        *(f"<h2>{html.escape(panel.title)}</h2>\n{table(columns(panel.score), panel_rows(panel))}" for panel in panels),
        f"<footer>First seed: {result.configuration['first_seed']}. {result.seconds_compiling:.0f} s compiling, "
        f"{result.seconds_running:.0f} s running. Zero-shot mean of the priors: {np.mean(means):.{digits}f} (lowest "
        f"{min(means):.{digits}f}). All numbers are in results.json, all returns in returns.npz.</footer>",
    ]
    text = page(words.title, parts, is_quick=result.quick)
    write_atomically(folder / "report.html", text.encode())
