"""The text of each figure's report."""

from collections.abc import Callable
from typing import Any, NamedTuple


class Wording(NamedTuple):
    """The text of one figure.

    Attributes:
        title: the title of the report.
        intro: the introduction; ``{seeds}`` and ``{tasks}`` are filled in.
        about_priors: makes a sentence from the rows of the priors.
        paper: the paper's numbers of updates to the goal, for Algorithm 2 and MAML.
    """

    title: str
    intro: str
    about_priors: Callable[[list[dict[str, Any]]], str]
    paper: str = ""


def _of_poles(rows: list[dict[str, Any]]) -> str:
    means = [row["zero_shot_mean"] for row in rows]
    good = sum(mean >= 195 for mean in means)
    return (
        f"{good} of {len(means)} priors balance unseen poles for 195 steps or more on average, before any "
        f"learning on them (lowest mean {min(means):.1f})."
    )


def _of_maps(rows: list[dict[str, Any]]) -> str:
    def span(name: str) -> str:
        values = [row[name] for row in rows]
        return f"{min(values):.2f}" if min(values) == max(values) else f"{min(values):.2f} to {max(values):.2f}"

    age = f"the priors, after {rows[0]['iterations']:,} iterations,"
    solved = f"Before any learning on them, {age} solve {span('zero_shot_mean')} of the unseen maps"
    if "multi_task_zero_shot_mean" not in rows[0]:  # no control was trained
        return f"{solved}; rank correlation of V with V* {span('rank_correlation')}."
    return (
        f"{solved}, those of multi-task DQN {span('multi_task_zero_shot_mean')}; rank correlation of V with V* "
        f"{span('rank_correlation')} and {span('multi_task_rank_correlation')}."
    )


_MAPS = (
    "A potential was meta-learned over maps, once per seed, and then used on {{tasks}} {unseen}. There are "
    "{{seeds}} seeds × {{tasks}} maps. A run scores 1 if its greedy policy reaches the goal within 50 steps, and 0 "
    "otherwise; the score is exact and uses the raw rewards. Curves are interquartile means with 95 % intervals of a "
    "bootstrap stratified by map. The last row shows discounted returns in the same way. "
    "Medians and quartiles are in results.json."
)

WORDING: dict[str, Wording] = {
    "fig1": Wording(
        "Figure 1: CartPoles with unseen pole lengths",
        "A potential was meta-learned over poles of many lengths, once per seed, and then used on {tasks} unseen "
        "poles. Every curve is the median over {seeds} seeds × {tasks} poles of the raw, unshaped return of the greedy "
        "policy; the shaded band lies between the quartiles. An episode ends after 200 steps, so the maximum return is "
        "200.",
        _of_poles,
        " (the paper: 4 and 8)",
    ),
    "fig3": Wording("Figure 3: clean maps with unseen goals", _MAPS.format(unseen="maps with unseen goals"), _of_maps),
    "fig5": Wording("Figure 5: unseen maps with obstacles", _MAPS.format(unseen="unseen maps"), _of_maps),
}
