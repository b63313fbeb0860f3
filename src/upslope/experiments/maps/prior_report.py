"""Reports on priors of maps (Figs. 2 and 4): the rows of a table, the aims, and an HTML page."""

from pathlib import Path
from typing import Any

import numpy as np

from upslope.experiments.maps.prior_plots import TITLES
from upslope.experiments.page import bullets, page, picture, table
from upslope.storage import write_atomically

COLUMNS = ("", "seconds", *TITLES.values())

_PICTURES = {
    "figure.png": "During training: means over unseen maps; bands from the lowest to the highest seed; aims dashed.",
    "map.png": "The first unseen map (not selected): learned V of the first prior, and V*.",
    "sheet.png": "Unseen maps, evenly from the worst rank correlation to the best.",
}


def prior_rows(results: dict[str, Any]) -> list[tuple[str, ...]]:
    """The table: every measure of the priors, mean over unseen maps and seeds, lowest and highest seed in brackets."""
    return [
        (row["what"], f"{row['seconds'][-1]:.0f}", *(_span(row["final"][measure]) for measure in TITLES))
        for row in results["readings"].values()
    ]


def _span(seeds: list[float]) -> str:
    mean = f"{np.mean(seeds):.3g}"
    return mean if len(seeds) == 1 else f"{mean} ({min(seeds):.3g} to {max(seeds):.3g})"


def about_aims(results: dict[str, Any], aims: dict[str, float]) -> list[str]:
    """One sentence for each aim: whether the priors of Algorithm 1 reach it on average.

    Args:
        results: the content of results.json.
        aims: the lowest mean that reaches the aim, by measure.
    """
    final = results["readings"]["algorithm1"]["final"]
    means = {measure: float(np.mean(final[measure])) for measure in aims}
    return [
        f"{TITLES[measure][0].upper()}{TITLES[measure][1:]}: {means[measure]:.4f} with Algorithm 1 "
        f"(aim: {aim:g}, {'reached' if means[measure] >= aim else 'missed'})."
        for measure, aim in aims.items()
    ]


def write_prior_report(title: str, results: dict[str, Any], aims: dict[str, float], folder: Path) -> None:
    """Writes report.html from the results and the pictures in the folder.

    Raises:
        NotSavedError: the disk is full, or the folder is missing or read-only.
    """
    settings = results["configuration"]
    intro = (
        f"<p>Priors were learned on training maps ({results['maps']}), {settings['seeds']} of each kind, and measured "
        f"exactly on {settings['tasks']} unseen maps.</p>"
    )
    parts = [intro, bullets(about_aims(results, aims)), table(COLUMNS, prior_rows(results))]
    for name, what in _PICTURES.items():
        parts.append(f"<h2>{what}</h2>\n{picture(folder / name, what)}")
    parts.append(
        f"<footer>First seed: {settings['first_seed']}. {results['seconds_compiling']:.0f} s compiling, "
        f"{results['seconds_running']:.0f} s running. All numbers are in results.json, all measures of single maps in "
        "maps.npz, the priors in *.safetensors.</footer>"
    )
    text = page(title, parts, is_quick=results["quick"])
    write_atomically(folder / "report.html", text.encode())
