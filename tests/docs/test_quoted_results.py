"""Every number that README.md quotes is the number in docs/data."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from upslope.learners.dqn import for_maps

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DEVIATIONS = (ROOT / "docs" / "deviations.md").read_text(encoding="utf-8")
FIGURE = json.loads((ROOT / "docs" / "data" / "fig1" / "results.json").read_text(encoding="utf-8"))
ROWS = re.findall(r"^\| `(\w+)/(\w+)` \| ([\d.]+) \| (\w+) \| ([\d.]+) \|", README, re.MULTILINE)


def test_the_readme_quotes_all_three_panels() -> None:
    assert {row[0] for row in ROWS} == {"left", "middle", "right"}


@pytest.mark.parametrize(("panel", "arm", "mean", "first", "quartile"), ROWS)
def test_readme_row(panel: str, arm: str, mean: str, first: str, quartile: str) -> None:
    measured = FIGURE["panels"][panel]["arms"][arm]
    assert mean == f"{measured['mean_over_evaluations']:.0f}"
    assert first == ("never" if measured["first_median_200"] is None else str(measured["first_median_200"]))
    assert quartile == f"{measured['q1'][-1]:.0f}"


def test_algorithm_2_against_maml() -> None:
    left, text = FIGURE["panels"]["left"], " ".join(README.split())
    less = left["algorithm2_less"][str(left["stop"])]["maml"]
    assert f"by {less['mean']:.0f} ({less['low']:.0f} to {less['high']:.0f}; 95 %" in text
    for stop in ("75", "100", "125", "150"):
        ours, theirs = (left["variants"][stop][name]["q1"][-1] for name in ("algorithm2", "maml"))
        assert re.search(rf"{ours:.0f} against {theirs:.0f} \((from )?{stop}", text), stop


def test_the_figure_is_the_full_one_at_the_papers_seeds() -> None:
    assert FIGURE["quick"] is False
    assert [row["seed"] for row in FIGURE["priors"]] == [0, 1, 2, 3, 4]
    assert FIGURE["configuration"]["tasks"] == 40


def test_deviations_table() -> None:
    variants = json.loads((ROOT / "docs" / "data" / "deviations" / "results.json").read_text())["variants"]
    for number, row in variants.items():
        good = f"{row['at_least_195']} of {len(row['zero_shot'])}"
        expected = f"| {row['median']:.0f} | {row['zero_shot'][0]:.0f} | {good} | {row['value_spread_median']:.2f} |"
        assert re.search(rf"^\| {number} \| .*{re.escape(expected)}$", DEVIATIONS, re.MULTILINE), number


def test_learners_table() -> None:
    variants = json.loads((ROOT / "docs" / "data" / "learners" / "results.json").read_text())["variants"]
    for name, row in variants.items():
        means = " | ".join(
            f"{row['arms'][arm]['mean_over_evaluations']:.0f}" for arm in ("unshaped", "constant", "prior")
        )
        assert f"| {name} | {means} | {row['arms']['prior']['q1'][-1]:.0f} |" in DEVIATIONS


def test_grid_learners_table() -> None:
    found = json.loads((ROOT / "docs" / "data" / "grid-learners" / "results.json").read_text())
    for name, row in found["variants"].items():
        means = [row["arms"][arm]["mean_over_evaluations"] for arm in ("unshaped", "manhattan", "oracle")]
        cells = " | ".join(f"{mean:.2f}" for mean in [*means, sum(means) / 3])
        assert f"| {name} | {cells} |" in DEVIATIONS
    best = max(
        found["variants"].values(), key=lambda row: sum(arm["mean_over_evaluations"] for arm in row["arms"].values())
    )
    for setting, value in best["settings"].items():
        here = getattr(for_maps(), setting)
        assert value == (list(here) if isinstance(here, tuple) else here), "the best of them is what is set"


def test_step_ratio_table() -> None:
    variants = json.loads((ROOT / "docs" / "data" / "step-ratio" / "results.json").read_text())["variants"]
    for (family, row), digits in zip(variants.items(), (0, 2), strict=True):
        for ratio, arm in row["arms"].items():
            mean, last = (f"{number:.{digits}f}" for number in (arm["mean_over_evaluations"], arm["iqm"][-1]))
            of_runs = "{} ({} to {})".format(*(f"{number:.{digits}f}" for number in arm["iqm_of_means"]))
            assert f"| {family}, {ratio} | {arm['step_size']:g} | {mean} | {of_runs} | {last} |" in DEVIATIONS


def test_the_readme_quotes_figure_4() -> None:
    found = json.loads((ROOT / "docs" / "data" / "fig4" / "results.json").read_text())
    text = " ".join(README.split())

    def mean(reading: str, measure: str) -> float:
        seeds = found["readings"][reading]["final"][measure]
        assert len(seeds) == 5
        return sum(seeds) / 5

    def percent(number: float) -> str:
        return f"{100 * number:.0f} %"

    assert f"rank correlation of V with V* is {mean('algorithm1', 'rank_correlation'):.2f}" in text
    assert percent(mean("algorithm1", "action_optimality")) + " of the greedy actions are optimal" in text
    assert percent(mean("algorithm1", "success")) + " of the maps are solved" in text
    control = [mean("multi_task_dqn", measure) for measure in ("rank_correlation", "action_optimality", "success")]
    assert f"comes to {control[0]:.2f}, {percent(control[1])} and {percent(control[2])}." in text
    assert found["configuration"]["tasks"] == 100


def test_clients_table() -> None:
    text = (ROOT / "docs" / "clients.md").read_text(encoding="utf-8")
    found = json.loads((ROOT / "docs" / "data" / "clients" / "results.json").read_text())
    for algorithm, row in found["algorithms"].items():
        for name, arm in row["arms"].items():
            first = "–" if arm["median_first"] is None else f"{arm['median_first']:.0f}"
            reached = f"{sum(one is not None for one in arm['first'])} of {len(arm['first'])}"
            cells = f"{first} | {reached} | {arm['mean']:.0f} | {arm['q1'][-1]:.0f}"
            assert f"| `{algorithm}/{name}` | {cells} |" in text


class TestGrids:
    """docs/grids.md."""

    TEXT = (ROOT / "docs" / "grids.md").read_text(encoding="utf-8")
    FIGURE_4 = json.loads((ROOT / "docs" / "data" / "fig4" / "results.json").read_text())
    READINGS = FIGURE_4["readings"]

    @pytest.mark.parametrize("figure", ["fig2", "fig4"])
    def test_what_the_priors_know(self, figure: str) -> None:
        readings = json.loads((ROOT / "docs" / "data" / figure / "results.json").read_text())["readings"]
        for name, row in readings.items():
            cells = (
                f"{np.mean(seeds):.3f} ({min(seeds):.3f} to {max(seeds):.3f})"
                for seeds in (row["final"][measure] for measure in ("rank_correlation", "action_optimality", "success"))
            )
            assert f"| `{name}` | {' | '.join(cells)} |" in self.TEXT

    def test_clean_maps(self) -> None:
        readings = json.loads((ROOT / "docs" / "data" / "fig2" / "results.json").read_text())["readings"]
        aims = {"rank_correlation": 0.97, "action_optimality": 0.9, "success": 0.9}

        def passes(name: str, measure: str) -> np.ndarray:
            curves = np.asarray(readings[name]["measures"][measure]["mean"])
            return np.vstack([curves, curves.mean(axis=0)]) >= aims[measure]

        ours = readings["algorithm1"]
        first = [ours["iterations"][passes("algorithm1", name)[-1].argmax()] for name in aims]
        assert "after {:,}, {:,} and {:,} iterations".format(*first) in self.TEXT
        assert all(passes("algorithm1", name)[:-1, -1].all() for name in aims), "with every seed"
        assert min(ours["final"]["action_optimality"]) == 1
        theirs = passes("multi_task_dqn", "success")[:-1]
        first = [ours["iterations"][row.argmax()] for row in theirs if row[-1]]
        assert len(first) == 4
        assert f"after {min(first):,} to {max(first):,} iterations" in self.TEXT
        assert f"one solves {min(readings['multi_task_dqn']['final']['success']):.2f}" in self.TEXT
        assert f"is {np.mean(ours['final']['rank_correlation']):.3f} and every greedy action is optimal" in README

    def test_readings(self) -> None:
        readings = json.loads((ROOT / "docs" / "data" / "grid-readings" / "results.json").read_text())["readings"]
        for name, row in readings.items():
            cells = (
                f"{np.mean(seeds):.2f} ({min(seeds):.2f} to {max(seeds):.2f})"
                for seeds in (row["final"][measure] for measure in ("rank_correlation", "action_optimality", "success"))
            )
            assert f"| `{name}` | {row['what']} | {' | '.join(cells)} |" in self.TEXT

    @pytest.mark.parametrize("figure", ["fig3-left", "fig5"])
    def test_adaptation(self, figure: str) -> None:
        left = json.loads((ROOT / "docs" / "data" / figure / "results.json").read_text())["panels"]["left"]
        for name in left["arms"]:
            arms = [of_stop[name] for of_stop in left["variants"].values()]
            cells = (f"{arm['mean_over_evaluations']:.3f} | {sum(q >= 1 for q in arm['q1'][1:])}" for arm in arms)
            assert f"| `{name}` | {' | '.join(cells)} |" in self.TEXT
        for stop, start in left["zero_shot_on_tuning_tasks"].items():
            assert figure == "fig5" or f"{int(stop):,} ({start:.2f})" in self.TEXT
            less = left["algorithm2_less"][stop]["maml"]
            said = "{mean:.3f} ({low:.3f} to {high:.3f}".format(**less).replace("-", "−")
            assert said in " ".join(self.TEXT.split())

    def test_the_stop_that_figure_5_shows(self) -> None:
        left = json.loads((ROOT / "docs" / "data" / "fig5" / "results.json").read_text())["panels"]["left"]
        starts = left["zero_shot_on_tuning_tasks"]
        assert left["stop"] == 2000
        assert f"2,000 ({starts['2000']:.2f}; {starts['4000']:.2f} at 4,000)" in self.TEXT

    def test_what_limits_them(self) -> None:
        row = self.READINGS["algorithm1"]
        on_training_maps = np.mean([of_seed[-1] for of_seed in row["success_on_training_maps"]])
        assert f"({on_training_maps:.3f} on average)" in self.TEXT
        assert f"({np.mean(row['final']['success']):.3f})" in self.TEXT
        maps = row["maps"]
        detours = np.asarray(self.FIGURE_4["detours"])
        correlation, success = np.mean(maps["rank_correlation"], axis=0), np.mean(maps["success"], axis=0)
        assert f"{np.corrcoef(detours, correlation)[0, 1]:.2f}".replace("-", "−") in self.TEXT
        for words, low, high in (
            ("below 0.25", -np.inf, 0.25),
            ("0.25 to 0.75", 0.25, 0.75),
            ("0.75 to 1.5", 0.75, 1.5),
            ("1.5 and more", 1.5, np.inf),
        ):
            here = (low <= detours) & (detours < high)
            cells = f"{here.sum()} | {correlation[here].mean():.3f} | {success[here].mean():.3f}"
            assert f"| {words} | {cells} |" in self.TEXT

    def test_how_far_behind_the_oracle_figure_5_is(self) -> None:
        right = json.loads((ROOT / "docs" / "data" / "fig5" / "results.json").read_text())["panels"]["right"]
        below = right["percent_below_oracle"]
        assert below["percent"] < 5, "the bar that was set"
        *most, last = (f"{one:.1f}" for one in sorted(below["of_seeds"]))
        said = (
            "{percent:.1f} % below V* itself (of resampled maps and seeds, {low:.1f} to {high:.1f} %; ".format(**below)
            + f"the single priors {', '.join(most)} and {last} %)"
        )
        assert said in " ".join(self.TEXT.split())
        assert f"{below['percent']:.1f} % behind V* itself" in " ".join(README.split())

    @pytest.mark.parametrize("figure", ["fig3", "fig5"])
    def test_shaped_dqn(self, figure: str) -> None:
        panel = json.loads((ROOT / "docs" / "data" / figure / "results.json").read_text())["panels"]["right"]
        for name, arm in panel["arms"].items():
            first = "never" if arm["first_median_solved"] is None else arm["first_median_solved"]
            less = panel["prior_less"].get(name)
            gap = "{mean:.3f} ({low:.3f} to {high:.3f}) ".format(**less).replace("-", "−") if less else ""
            cells = f"{arm['mean_over_evaluations']:.3f} | {first} | {arm['q1'][-1]:.0f} | {gap}|"
            assert f"| `{name}` | {cells}" in self.TEXT
        means = {name: arm["mean_over_evaluations"] for name, arm in panel["arms"].items()}
        if figure == "fig5":
            assert f"{100 * (1 - means['prior'] / means['oracle']):.1f} % below V*" in self.TEXT
        else:
            level = [panel["prior_less"][name] for name in ("oracle", "manhattan", "multi_task_dqn")]
            assert all(one["low"] < 0 < one["high"] for one in level)
            farthest = max(abs(one[end]) for one in level for end in ("low", "high"))
            assert f"farther than {farthest:.3f} from zero" in self.TEXT
