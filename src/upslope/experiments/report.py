"""What a figure says: a table in the terminal, and a page to read."""

import base64
import html
import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from upslope.experiments.plots import STYLES
from upslope.experiments.results import FigureResult, Panel

COLUMNS = ("arm", "start", "end", "lower quartile at end", "mean", "195 first at", "200 first at")


def print_summary(result: FigureResult, console: Console) -> None:
    """One table per panel, then the sentences that the numbers allow."""
    for panel in result.panels.values():
        table = Table(*COLUMNS, title=panel.title, title_justify="left")
        for row in panel_rows(panel):
            table.add_row(*row)
        console.print(table)
    for sentence in findings(result):
        console.print(f"• {sentence}", highlight=False)


def panel_rows(panel: Panel) -> list[tuple[str, ...]]:
    """The table of a panel: medians at the first and last evaluation, and when the top was first reached."""
    rows: list[tuple[str, ...]] = []
    for name, arm in panel.arms.items():
        summary = arm.summary
        first, last = summary["first_median_195"], summary["first_median_200"]
        rows.append(
            (
                STYLES[name][0],
                f"{summary['median'][0]:.0f}",
                f"{summary['median'][-1]:.0f}",
                f"{summary['q1'][-1]:.0f}",
                f"{summary['mean_over_evaluations']:.1f}",
                "never" if first is None else str(first),
                "never" if last is None else str(last),
            )
        )
    return rows


def findings(result: FigureResult) -> list[str]:
    """Sentences computed from the numbers; none is said that they do not bear out."""
    sentences = [_about_priors(result)]
    for name in ("middle", "right"):
        if name in result.panels:
            sentences.append(_about_shaping(result.panels[name]))
    if "left" in result.panels:
        sentences.append(_about_adaptation(result.panels["left"]))
    return sentences


def _about_priors(result: FigureResult) -> str:
    means = [row["zero_shot_mean"] for row in result.priors]
    good = sum(mean >= 195 for mean in means)
    return (
        f"{good} of {len(means)} priors balance unseen poles for 195 steps or more on average before any learning "
        f"there (lowest mean {min(means):.1f})."
    )


def _about_shaping(panel: Panel) -> str:
    means = {name: float(arm.returns.mean()) for name, arm in panel.arms.items()}
    ratio, control = means["prior"] / means["unshaped"], means["prior"] / means["constant"]
    return (
        f"{panel.title}: shaped by the prior, the mean over all evaluations is {means['prior']:.0f} against "
        f"{means['unshaped']:.0f} without shaping ({ratio:.2f} times) and {means['constant']:.0f} with a constant "
        f"potential ({control:.2f} times); the mean of the priors gives {means['prior_ensemble']:.0f}, "
        f"the oracle {means['oracle']:.0f}."
    )


def _about_adaptation(panel: Panel) -> str:
    ours, theirs = panel.arms["algorithm2"].summary, panel.arms["maml"].summary

    def reached(summary: dict) -> float:
        return math.inf if summary["first_median_200"] is None else summary["first_median_200"]

    if reached(ours) == reached(theirs) == math.inf:
        speed = "neither Algorithm 2 nor MAML reaches a median of 200"
    else:
        said = [f"{value:.0f}" if math.isfinite(value) else "never" for value in (reached(ours), reached(theirs))]
        speed = f"the median first reaches 200 at update {said[0]} with Algorithm 2 and {said[1]} with MAML"
    return (
        f"{panel.title}: {speed} (the paper: 4 and 8); lower quartile at the end {ours['q1'][-1]:.0f} and "
        f"{theirs['q1'][-1]:.0f}, mean over updates {ours['mean_over_evaluations']:.0f} and "
        f"{theirs['mean_over_evaluations']:.0f}."
    )


def write_report(result: FigureResult, folder: Path) -> None:
    """Writes report.html: the picture, the findings and the tables, in one file that needs no other."""
    picture = base64.b64encode((folder / "figure.png").read_bytes()).decode()
    sections = "\n".join(_section(panel) for panel in result.panels.values())
    notes = "\n".join(f"<li>{html.escape(sentence)}</li>" for sentence in findings(result))
    quick = "<p class='quick'>This is the quick form: too small to say anything about the paper.</p>"
    seeds, tasks = next(iter(next(iter(result.panels.values())).arms.values())).returns.shape[:2]
    page = _PAGE.format(
        title="Figure 1: CartPoles with unseen pole lengths",
        quick=quick if result.quick else "",
        notes=notes,
        picture=picture,
        sections=sections,
        seeds=seeds,
        tasks=tasks,
        first_seed=result.configuration["first_seed"],
        compiling=f"{result.seconds_compiling:.0f}",
        running=f"{result.seconds_running:.0f}",
        lowest=f"{min(row['zero_shot_mean'] for row in result.priors):.1f}",
        average=f"{np.mean([row['zero_shot_mean'] for row in result.priors]):.1f}",
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _section(panel: Panel) -> str:
    head = "".join(f"<th>{column}</th>" for column in COLUMNS)
    rows = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in panel_rows(panel))
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    return f"<h2>{html.escape(panel.title)}</h2>\n<table><tr>{head}</tr>\n{body}</table>"


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>
 body {{ font: 16px/1.5 Georgia, serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
 h1, h2 {{ font-weight: normal; }} h2 {{ margin-top: 2rem; }} img {{ width: 100%; }}
 table {{ border-collapse: collapse; font: 14px/1.4 sans-serif; }} .quick {{ color: #b2182b; font-weight: bold; }}
 th, td {{ padding: .25rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }}
 th:first-child, td:first-child {{ text-align: left; }} footer {{ margin-top: 2rem; color: #777; font-size: 14px; }}
</style></head><body>
<h1>{title}</h1>
{quick}
<p>A potential was meta-learned over poles of every length, once per seed, and then met {tasks} poles that it had
never seen. Every curve is the median over {seeds} seeds × {tasks} poles of the raw, unshaped return of the greedy
policy; the shade lies between the quartiles. An episode ends after 200 steps, so 200 is the top.</p>
<ul>
{notes}
</ul>
<img alt="Figure 1" src="data:image/png;base64,{picture}">
{sections}
<footer>Seeds from {first_seed} on. {compiling} s compiling, {running} s running. Zero-shot mean of the priors
{average}, lowest {lowest}. All numbers are in results.json, all returns in returns.npz.</footer>
</body></html>
"""
