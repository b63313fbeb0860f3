"""The tables about CartPoles: Figure 1, the studies of its settings, and other libraries' learners."""

import json
from typing import Any

from docs.numbers.shared import DATA, interval, load, number, or_never, table

ARMS = {
    "unshaped": "no shaping",
    "constant": "constant potential (control)",
    "prior": "**meta-learned prior**",
    "prior_ensemble": "mean of the five priors",
    "prior_unzeroed": "prior, Φ kept at failures (not policy-invariant)",
    "oracle": "oracle",
    "maml": "MAML fine-tuning",
    "maml_two_steps": "MAML fine-tuning, two steps",
    "frozen_potential": "V frozen, two A steps (control)",
    "td_centred": "TD on V + A − frozen max A (control)",
    "algorithm2": "**Algorithm 2**",
    "algorithm2_raw": "Algorithm 2, A not centred",
}
LEARNERS = {"middle": "DQN", "right": "DDPG"}


def figure1_short() -> str:
    """The three arms of DQN that the README shows."""
    arms = load("fig1")["panels"]["middle"]["arms"]
    rows = [(ARMS[name], *_curve(arms[name])) for name in ("unshaped", "constant", "prior")]
    return table(("DQN with", "mean return", "updates until the median is 200", "lower quartile at the end"), rows)


def figure1_protocol() -> str:
    """What the numbers of Figure 1 are measured on."""
    figure = load("fig1")
    if figure["quick"]:
        raise ValueError("docs/data/fig1 holds the quick form: run `upslope reproduce fig1`.")
    seeds = [row["seed"] for row in figure["priors"]]
    return f"{len(seeds)} priors (seeds {seeds[0]} to {seeds[-1]}), {figure['configuration']['tasks']} unseen poles."


def figure1_shaping() -> str:
    """Every arm of the middle and right panels."""
    rows = []
    for panel, learner in LEARNERS.items():
        arms = load("fig1")["panels"][panel]["arms"]
        for name in ("unshaped", "constant", "prior", "prior_ensemble", "prior_unzeroed", "oracle"):
            times = arms["prior"]["mean_over_evaluations"] / arms[name]["mean_over_evaluations"]
            rows.append((learner, ARMS[name], *_curve(arms[name]), f"{times:.2f}"))
    head = ("learner", "potential", "mean return", "updates until the median is 200", "lower quartile at the end")
    return table((*head, "the prior's mean divided by this one"), rows)


def figure1_adaptation() -> str:
    """Every arm of the left panel, at the stop that the picture shows."""
    left = load("fig1")["panels"]["left"]
    less = left["algorithm2_less"][str(left["stop"])]
    rows = [
        (ARMS[name], *_curve(arm), interval(less[name], 0) if name in less else "")
        for name, arm in left["arms"].items()
    ]
    head = ("arm", "mean return", "updates until the median is 200", "lower quartile at the end")
    return table((*head, "Algorithm 2's mean minus this one (95 %)"), rows)


def figure1_stops() -> str:
    """Algorithm 2 and MAML from priors of different ages."""
    left = load("fig1")["panels"]["left"]
    rows = []
    for stop, arms in left["variants"].items():
        ours, theirs = (arms[name] for name in ("algorithm2", "maml"))
        rows.append(
            (
                stop,
                f"{left['zero_shot_on_tuning_tasks'][stop]:.0f}",
                interval(left["algorithm2_less"][stop]["maml"], 0),
                *(or_never(arm["first_median_200"]) for arm in (ours, theirs)),
                *(f"{arm['q1'][-1]:.0f}" for arm in (ours, theirs)),
            )
        )
    return table(
        (
            "Algorithm 1 stopped at",
            "return before adaptation",
            "Algorithm 2's mean minus MAML's (95 %)",
            "median at 200: Algorithm 2",
            "MAML",
            "lower quartile at the end: Algorithm 2",
            "MAML",
        ),
        rows,
    )


def deviations() -> str:
    """The effect of each difference from the printed Algorithm 1."""
    rows = [
        (
            name,
            row["what"],
            f"{row['median']:.0f}",
            f"{row['zero_shot'][0]:.0f}",
            f"{row['at_least_195']} of {len(row['zero_shot'])}",
            f"{row['value_spread_median']:.2f}",
        )
        for name, row in load("deviations")["variants"].items()
    ]
    return table(("", "changed", "median", "lowest", "≥ 195", "spread of V"), rows)


def learners() -> str:
    """The effect of DQN's and DDPG's settings on each arm, on poles."""
    rows = [
        (
            name,
            *(f"{row['arms'][arm]['mean_over_evaluations']:.0f}" for arm in ("unshaped", "constant", "prior")),
            f"{row['arms']['prior']['q1'][-1]:.0f}",
        )
        for name, row in load("learners")["variants"].items()
    ]
    return table(("settings", "unshaped", "constant", "prior", "prior: lower quartile at the end"), rows)


def step_ratio() -> str:
    """How long the step of Eq. 9 should be."""
    rows = []
    for (family, row), digits in zip(load("step-ratio")["variants"].items(), (0, 2), strict=True):
        for ratio, arm in row["arms"].items():
            middle, low, high = (f"{bound:.{digits}f}" for bound in arm["iqm_of_means"])
            mean, last = (f"{score:.{digits}f}" for score in (arm["mean_over_evaluations"], arm["iqm"][-1]))
            rows.append((family, ratio, f"{arm['step_size']:g}", mean, f"{middle} ({low} to {high})", last))
    head = ("tasks", "ratio", "step size", "mean over 20 updates", "interquartile mean of the runs (95 %)")
    return table((*head, "interquartile mean after 20 updates"), rows)


def clients() -> str:
    """Stable-Baselines3's learners on fresh poles."""
    rows = []
    for algorithm, row in load("clients")["algorithms"].items():
        for name, arm in row["arms"].items():
            reached = sum(first is not None for first in arm["first"])
            first = "–" if arm["median_first"] is None else f"{arm['median_first']:.0f}"
            ends = (f"{arm['mean']:.0f}", f"{arm['q1'][-1]:.0f}")
            rows.append((algorithm, name, first, f"{reached} of {len(arm['first'])}", *ends))
    head = ("learner", "arm", "median steps to 195", "poles that reached 195", "mean return over the run")
    return table((*head, "lower quartile at the end"), rows)


def clients_short() -> str:
    """The README's sentence about Stable-Baselines3."""
    found = load("clients")["algorithms"]
    first = {name: {arm: of["median_first"] for arm, of in row["arms"].items()} for name, row in found.items()}
    if first["DQN"]["unshaped"] is not None:
        raise ValueError("The unshaped DQN reaches 195 now: rewrite the sentence.")
    return (
        f"With the shipped prior, Stable-Baselines3's DQN reaches a return of 195 on fresh poles after "
        f"{first['DQN']['shaped']:.0f} steps (median); without shaping it does not within {found['DQN']['steps']:,}. "
        f"Its SAC, which has continuous actions, needs {first['SAC']['shaped']:.0f} steps instead of "
        f"{first['SAC']['unshaped']:,.0f}."
    )


def clients_tuning() -> str:
    """The settings of Stable-Baselines3's learners on tuning poles; the best of each learner is in bold."""
    lines = (DATA / "clients" / "tuning.jsonl").read_text(encoding="utf-8").splitlines()
    returns: dict[tuple[str, str], dict[str, list[float]]] = {}
    for run in map(json.loads, lines):
        arms = returns.setdefault((run["algorithm"], run["variant"]), {})
        arms.setdefault(run["arm"], []).append(sum(run["returns"]) / len(run["returns"]))
    rows = []
    for (algorithm, variant), arms in returns.items():
        means = [sum(arms[name]) / len(arms[name]) for name in ("unshaped", "constant", "shaped")]
        rows.append((algorithm, f"{algorithm}, {variant}", [*means, sum(means) / 3]))
    best = {algorithm: max(row[2][-1] for row in rows if row[0] == algorithm) for algorithm, *_ in rows}
    head = ("on the tuning poles", "no shaping", "constant", "prior", "mean of the arms")
    return table(
        head,
        [
            (f"**{name}**" if means[-1] == best[algorithm] else name, *(f"{mean:.0f}" for mean in means))
            for algorithm, name, means in rows
        ],
    )


def _curve(arm: dict[str, Any]) -> tuple[str, str, str]:
    return number(arm["mean_over_evaluations"], 0), or_never(arm["first_median_200"]), number(arm["q1"][-1], 0)
