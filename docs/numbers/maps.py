"""The tables about grid maps: Figures 2 to 5 and the studies of their settings."""

from typing import Any

import numpy as np
from docs.numbers.shared import interval, load, number, or_never, seed_range, table

MEASURES = {
    "rank_correlation": "rank correlation of V with V*",
    "action_optimality": "optimal greedy actions",
    "success": "zero-shot success",
}
RECIPES = {"algorithm1": "Algorithm 1", "multi_task_dqn": "multi-task DQN"}
AIMS = {
    "fig2": {"rank_correlation": 0.97, "action_optimality": 0.9, "success": 0.9},
    "fig4": {"rank_correlation": 0.95, "action_optimality": 0.88, "success": 0.7},
}
DETOURS = {
    "below 0.25": (-np.inf, 0.25),
    "0.25 to 0.75": (0.25, 0.75),
    "0.75 to 1.5": (0.75, 1.5),
    "1.5 and more": (1.5, np.inf),
}


def priors_short() -> str:
    """The README's table: what the priors know of unseen maps."""
    rows = []
    for figure, maps in (("fig4", "obstacles, 8 × 8"), ("fig2", "clean, 10 × 10")):
        for name, row in load(figure)["readings"].items():
            means = (f"{np.mean(row['final'][measure]):.3f}" for measure in MEASURES)
            rows.append((maps, RECIPES[name], *means))
    return table(("unseen maps", "learned by", *MEASURES.values()), rows)


def priors(figure: str) -> str:
    """What the priors know of unseen maps at the end of their training."""
    rows = [
        (RECIPES[name], *(seed_range(row["final"][measure], 3) for measure in MEASURES))
        for name, row in load(figure)["readings"].items()
    ]
    rows.append(("aim", *(f"{aim:g}" for aim in AIMS[figure].values())))
    return table(("", *MEASURES.values()), rows)


def aims(figure: str) -> str:
    """When the priors pass the aims."""
    readings = load(figure)["readings"]
    rows = []
    for name, row in readings.items():
        for measure, aim in AIMS[figure].items():
            curves = np.asarray(row["measures"][measure]["mean"])
            first = _first_at_least(row["iterations"], curves.mean(axis=0), aim)
            passed = [_first_at_least(row["iterations"], seed, aim) for seed in curves if seed[-1] >= aim]
            mean = "never" if first is None else f"{first:,}"
            passed.sort()
            ends = " to ".join(f"{end:,}" for end in sorted({*passed[:1], *passed[-1:]}))
            count = f"{len(passed)} of {len(curves)}"
            rows.append((RECIPES[name], MEASURES[measure], mean, count, ends or "–"))
    head = ("", "measure", "mean over seeds passes after", "seeds above the aim at the end", "these pass after")
    return table(head, rows)


def detours() -> str:
    """Figure 4's maps by how far their walls lead around."""
    figure = load("fig4")
    lengths = np.asarray(figure["detours"])
    maps = figure["readings"]["algorithm1"]["maps"]
    correlation, success = (np.mean(maps[name], axis=0) for name in ("rank_correlation", "success"))
    rows = []
    for name, (low, high) in DETOURS.items():
        here = (low <= lengths) & (lengths < high)
        rows.append((name, str(here.sum()), f"{correlation[here].mean():.3f}", f"{success[here].mean():.3f}"))
    return table(("mean detour of a map, steps", "maps", "rank correlation", "zero-shot success"), rows)


def limits() -> str:
    """How detours and the training maps bear on Figure 4's priors."""
    figure = load("fig4")
    row = figure["readings"]["algorithm1"]
    correlation = np.mean(row["maps"]["rank_correlation"], axis=0)
    seen = np.mean([seed[-1] for seed in row["success_on_training_maps"]])
    return (
        "Over the maps, the correlation between mean detour and rank correlation is "
        f"{number(np.corrcoef(figure['detours'], correlation)[0, 1], 2)}. On forty training maps the same priors solve "
        f"{seen:.3f}; on the {figure['configuration']['tasks']} unseen ones {np.mean(row['final']['success']):.3f}."
    )


def readings() -> str:
    """Algorithm 1 read in other ways."""
    rows = [
        (f"`{name}`", row["what"], *(seed_range(row["final"][measure], 2) for measure in MEASURES))
        for name, row in load("grid-readings")["readings"].items()
    ]
    return table(("", "φ_i and N", *MEASURES.values()), rows)


def shaping(figure: str) -> str:
    """Shaped DQN on unseen maps."""
    panel = load(figure)["panels"]["right"]
    rows = []
    for name, arm in panel["arms"].items():
        less = panel["prior_less"].get(name)
        ends = (or_never(arm["first_median_solved"]), f"{arm['q1'][-1]:.0f}")
        rows.append((f"`{name}`", f"{arm['mean_over_evaluations']:.3f}", *ends, interval(less, 3) if less else ""))
    head = ("arm", "mean success", "updates until the median run solves its map", "lower quartile at the end")
    return table((*head, "prior minus this (95 %)"), rows)


def oracle() -> str:
    """How far the prior is behind V* in Figure 5."""
    below = load("fig5")["panels"]["right"]["percent_below_oracle"]
    *most, last = (f"{percent:.1f}" for percent in sorted(below["of_seeds"]))
    return (
        f"The learned prior is {below['percent']:.1f} % below V* (95 % interval over maps and seeds: "
        f"{below['low']:.1f} to {below['high']:.1f} %; the single priors: {', '.join(most)} and {last} %)."
    )


def level() -> str:
    """How far the prior is from the best potentials in Figure 3."""
    less = load("fig3")["panels"]["right"]["prior_less"]
    gaps = [less[name] for name in ("oracle", "manhattan", "multi_task_dqn")]
    if not all(gap["low"] < 0 < gap["high"] for gap in gaps):
        raise ValueError("The prior is not level with V*, Manhattan distance and multi-task DQN any more.")
    farthest = max(abs(gap[end]) for gap in gaps for end in ("low", "high"))
    return (
        "The learned prior is level with V*, with Manhattan distance and with the V of multi-task DQN: all three "
        f"intervals include zero, and none reaches farther than {farthest:.3f} from it."
    )


def starts(figure: str) -> str:
    """How many tuning maps the priors solve at each stop, before adaptation."""
    left = load(figure)["panels"]["left"]
    of_stops = (f"{int(stop):,} ({start:.2f})" for stop, start in left["zero_shot_on_tuning_tasks"].items())
    return (
        "The stops, with the success on tuning maps before adaptation: "
        f"{', '.join(of_stops)}. The picture shows {left['stop']:,}."
    )


def adaptation(figure: str) -> str:
    """Adaptation on unseen maps, from every stop."""
    left = load(figure)["panels"]["left"]
    rows = []
    for stop, arms in left["variants"].items():
        less = left["algorithm2_less"][stop]
        for name, arm in arms.items():
            gap = interval(less[name], 3) if name in less else ""
            rows.append((f"{int(stop):,}", f"`{name}`", *_course(arm), gap))
    head = (
        "stop",
        "arm",
        "mean success",
        "start",
        "highest (updates)",
        "end",
        "median solved after",
        "lower quartile solved",
    )
    return table((*head, "Algorithm 2 minus this (95 %)"), rows)


def learners() -> str:
    """The effect of DQN's settings on maps."""
    rows = []
    for name, row in load("grid-learners")["variants"].items():
        means = [row["arms"][arm]["mean_over_evaluations"] for arm in ("unshaped", "manhattan", "oracle")]
        rows.append((name, *(f"{mean:.2f}" for mean in [*means, sum(means) / 3])))
    return table(("settings", "unshaped", "Manhattan", "V*", "mean"), rows)


def _course(arm: dict[str, Any]) -> tuple[str, ...]:
    """An arm's mean success, its interquartile mean over the updates, and when its runs solve their maps."""
    curve = arm["iqm"]
    best = int(np.argmax(curve))
    return (
        f"{arm['mean_over_evaluations']:.3f}",
        f"{curve[0]:.2f}",
        f"{curve[best]:.2f} ({arm['updates'][best]})",
        f"{curve[-1]:.2f}",
        or_never(arm["first_median_solved"]),
        str(sum(quartile >= 1 for quartile in arm["q1"][1:])),
    )


def _first_at_least(iterations: list[int], curve: np.ndarray, aim: float) -> int | None:
    reached = np.flatnonzero(curve >= aim)
    return iterations[reached[0]] if reached.size else None
