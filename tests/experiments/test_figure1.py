"""Figure 1 in miniature: what it writes, that it is deterministic, and that its report follows from its numbers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from upslope.experiments.adaptation_panel import RULES, AdaptationPanel
from upslope.experiments.plots import STYLES, draw
from upslope.experiments.poles.figure1 import Figure1Config, figure1
from upslope.experiments.report import findings, print_summary, write_report
from upslope.experiments.results import FigureResult, write_results
from upslope.learners.ddpg import DDPGConfig
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.run.compiling import CompileClock, compile_clock
from upslope.run.session import Session

SHAPING_ARMS = ["unshaped", "constant", "prior", "prior_ensemble", "prior_unzeroed", "oracle"]
#: Ten large programs: to start and to advance priors, oracles, adaptation, DQN and DDPG. The others are single
#: operations, which take some hundredths of a second each. A program for each of the six arms would be too many.
MOST_PROGRAMS = 52
SMALL = MetaTrainingConfig(
    iterations=20, tasks=4, steps_per_task=40, posterior=NetworkPosterior(batch_size=16), evaluation_tasks=3
)
TINY = Figure1Config(
    seeds=2,
    tasks=3,
    dqn_updates=20,
    ddpg_updates=20,
    every=10,
    meta_training=SMALL,
    oracle=replace(SMALL, iterations=10),
    panel=AdaptationPanel(stops=(10, 20), updates=2, step_sizes=(1e-3, 2e-3)),
    dqn=DQNConfig(batch_size=8, warmup_steps=10, replay_capacity=64),
    ddpg=DDPGConfig(batch_size=8, warmup_steps=10, replay_capacity=64),
)


# CI makes the quick form of the figure by its command; this miniature belongs to `make check-all`.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clock() -> CompileClock:
    """Of the compiling for `result`."""
    return CompileClock()


@pytest.fixture(scope="module")
def shown() -> list[FigureResult]:
    """The unfinished figures that the session showed before `result` was complete."""
    return []


@pytest.fixture(scope="module")
def result(clock: CompileClock, shown: list[FigureResult], tmp_path_factory: pytest.TempPathFactory) -> FigureResult:
    folder = tmp_path_factory.mktemp("growing")

    def show(so_far: FigureResult) -> None:
        draw(so_far, folder)
        shown.append(so_far)

    with compile_clock() as running:
        finished = figure1(TINY, is_quick=True, session=Session(show=show))
    clock.programs = running.programs
    return finished


@pytest.fixture(scope="module")
def folder(result: FigureResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fig1")
    write_results(result, folder)
    draw(result, folder)
    write_report(result, folder)
    return folder


def test_the_same_command_twice_gives_the_same_bits(result: FigureResult) -> None:
    again = figure1(TINY, is_quick=True)
    for name, panel in result.panels.items():
        for arm, curves in panel.arms.items():
            np.testing.assert_array_equal(curves.returns, again.panels[name].arms[arm].returns)


def test_one_program_serves_all_arms_seeds_and_repeats(result: FigureResult, clock: CompileClock) -> None:
    """Users wait for compiling, so this test limits the number of compiled programs."""
    assert len(result.panels) == 3
    assert 10 <= clock.programs <= MOST_PROGRAMS


def test_it_can_be_seen_after_each_panel_but_the_last(result: FigureResult, shown: list[FigureResult]) -> None:
    seen = [(list(so_far.panels), so_far.pending) for so_far in shown]
    assert seen == [(["left"], ("middle", "right")), (["left", "middle"], ("right",))]
    assert result.pending == ()
    for so_far in shown:
        assert all(panel is result.panels[name] for name, panel in so_far.panels.items())
        assert so_far.quick
        np.testing.assert_array_equal(so_far.training["returns"], result.training["returns"])


def test_every_arm_of_every_panel_is_there(folder: Path) -> None:
    returns = np.load(folder / "returns.npz")
    for panel, arms, evaluations in (("left", list(RULES), 3), ("middle", SHAPING_ARMS, 3), ("right", SHAPING_ARMS, 3)):
        for arm in arms:
            assert returns[f"{panel}/{arm}"].shape == (2, 3, evaluations)
    assert set(STYLES) == {*RULES, *SHAPING_ARMS, "multi_task_dqn", "manhattan"}  # the last two on maps only


def test_returns_are_raw_lengths_of_episodes(folder: Path) -> None:
    for returns in np.load(folder / "returns.npz").values():
        assert returns.min() >= 1
        assert returns.max() <= 200


def test_results_follow_from_the_returns(folder: Path) -> None:
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    returns = np.load(folder / "returns.npz")
    for panel_name, panel in results["panels"].items():
        for name, arm in panel["arms"].items():
            runs = returns[f"{panel_name}/{name}"].reshape(6, -1)
            np.testing.assert_allclose(arm["median"], np.median(runs, axis=0))
            np.testing.assert_allclose(arm["q1"], np.percentile(runs, 25, axis=0))
            np.testing.assert_allclose(arm["mean_over_evaluations"], runs.mean(), rtol=1e-6)
            assert all(
                low <= mid <= high for low, mid, high in zip(arm["iqm_low"], arm["iqm"], arm["iqm_high"], strict=True)
            )
            assert arm["first_median_200"] is None or arm["first_median_200"] in arm["updates"]


def test_each_arm_takes_the_step_size_that_was_best_on_tuning_tasks(folder: Path) -> None:
    left = json.loads((folder / "results.json").read_text(encoding="utf-8"))["panels"]["left"]
    for arms in (left["arms"], *left["variants"].values()):
        for arm in arms.values():
            tried = arm["means_on_tuning_tasks"]
            assert list(map(float, tried)) == list(TINY.panel.step_sizes)
            assert tried[f"{arm['step_size']:g}"] == max(tried.values())


def test_results_say_what_they_were_made_with(folder: Path) -> None:
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert [row["seed"] for row in results["priors"]] == [0, 1]
    assert {"zero_shot_median", "zero_shot_mean", "zero_shot_lower_quartile"} <= set(results["priors"][0])
    assert {"upslope", "jax", "python"} <= set(results["versions"])
    assert results["hardware"]["cores"] >= 1
    assert results["configuration"]["dqn"]["batch_size"] == 8
    assert results["seconds_compiling"] > 0
    assert results["quick"] is True


def test_arms_share_their_start(result: FigureResult) -> None:
    """All arms of a shaping panel begin from the same networks, so their first evaluation is the same."""
    for name in ("middle", "right"):
        starts = [arm.returns[..., 0] for arm in result.panels[name].arms.values()]
        for start in starts[1:]:
            np.testing.assert_array_equal(start, starts[0])


def test_other_seeds_move_the_test_tasks(result: FigureResult) -> None:
    shown: list[FigureResult] = []
    moved = figure1(replace(TINY, first_seed=7), panels=("middle",), session=Session(show=shown.append))
    assert list(moved.panels) == ["middle"]
    assert not shown, "a single panel is seen when all is done"
    ours, theirs = result.panels["middle"].arms["unshaped"], moved.panels["middle"].arms["unshaped"]
    assert not np.array_equal(ours.returns, theirs.returns)


def test_pictures_and_report(folder: Path) -> None:
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "figure.pdf").read_bytes().startswith(b"%PDF")
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "quick form" in page
    assert "data:image/png;base64," in page
    assert page.count("<table>") == 3


def test_summary_and_findings_quote_the_numbers(result: FigureResult) -> None:
    console = Console(record=True, width=120, file=open("/dev/null", "w"))  # noqa: SIM115
    print_summary(result, console)
    text = console.export_text()
    console.file.close()
    mean = result.panels["middle"].arms["prior"].returns.mean()
    assert f"{mean:.1f}" in text
    assert any(f"is {mean:.0f}, compared with" in sentence for sentence in findings(result))
