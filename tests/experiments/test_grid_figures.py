"""Figures 3 and 5 in miniature: what they write, that they are deterministic, and which maps they use."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from support.plain_grids import draw
from upslope.adaptation.algorithm2 import AdaptationConfig
from upslope.errors import UpslopeError
from upslope.experiments import catalogue
from upslope.experiments.adaptation_panel import RULES, AdaptationPanel
from upslope.experiments.maps.figures import GridFigureConfig, full_grid_figure, grid_figure, quick_grid_figure
from upslope.experiments.maps.priors import families
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.recipes import for_grid_games, multi_task_dqn
from upslope.run.session import Session
from upslope.tasks.grid_maps import is_test_map

ARMS = ["unshaped", "constant", "prior", "prior_ensemble", "prior_unzeroed", "multi_task_dqn", "manhattan", "oracle"]
SMALL = {"hidden": (8, 8), "steps_per_task": 20, "snapshot_every": 2, "evaluation_tasks": 2}
TINY = GridFigureConfig(
    "obstacles",
    seeds=2,
    tasks=3,
    dqn_updates=4,
    every=2,
    meta_training=replace(for_grid_games(4), **SMALL).with_posterior(environments=2),
    multi_task=replace(multi_task_dqn(4), **SMALL).with_posterior(environments=2),
    panel=AdaptationPanel(stops=(0, 2), updates=2, step_sizes=(0.01, 0.1), start=0.5, average="mean"),
    adaptation=AdaptationConfig(batch_size=4, replay_capacity=64, steps_per_update=5),
    dqn=DQNConfig(hidden=(8, 8), batch_size=4, warmup_steps=5, replay_capacity=64),
)


class TestSettings:
    def test_iterations_move_the_stops_along(self):
        config = full_grid_figure("obstacles", 2400)
        assert config.meta_training.iterations == config.multi_task.iterations == 2400
        assert config.panel.stops == (600, 1200, 2400)
        assert config.meta_training == for_grid_games(2400)

    @pytest.mark.parametrize(("maps", "iterations"), [("obstacles", 8000), ("clean", 3000)])
    def test_the_whole_protocol(self, maps, iterations):
        config = full_grid_figure(maps)
        assert config.meta_training == for_grid_games(iterations)
        assert config.multi_task == multi_task_dqn(iterations)
        assert (config.seeds, config.tasks) == (5, 40)
        assert max(config.panel.stops) <= iterations

    def test_the_quick_form_keeps_the_recipes(self):
        config = quick_grid_figure(full_grid_figure("obstacles"))
        assert config.meta_training.posterior.inner_steps == 30
        assert config.multi_task.posterior.inner_steps == 1
        assert config.dqn == full_grid_figure("obstacles").dqn

    @pytest.mark.parametrize("settings", [{"seeds": 0}, {"tasks": 0}])
    def test_nothing_makes_no_figure(self, settings):
        with pytest.raises(UpslopeError, match="A figure needs at least 1 seed and 1 map"):
            replace(full_grid_figure("clean"), **settings)

    def test_no_iterations_teach_nothing(self):
        with pytest.raises(UpslopeError, match="0 iterations"):
            full_grid_figure("clean", 0)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"experiment": "fig5", "panels": ["middle"]}, "no middle panel"),
            ({"experiment": "fig5", "iterations": 0}, "0 iterations"),
            ({"experiment": "fig1", "iterations": 5}, "fixed number of iterations"),
            ({"experiment": "fig4", "priors_of": Path("elsewhere")}, "fig4 takes no priors of another figure"),
        ],
    )
    def test_bad_commands_write_nothing(self, arguments, message, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(UpslopeError, match=message):
            catalogue.reproduce(**arguments)
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("maps", ["obstacles", "clean"])
    def test_no_tuning_map_is_a_test_map(self, maps):
        family, unseen = families(maps)
        tuning, tests = draw(family, 20), draw(unseen, 20)
        if maps == "clean":
            assert not set(tuning.goal.tolist()) & set(tests.goal.tolist())
        else:
            of_tests = jax.jit(jax.vmap(is_test_map))
            assert np.asarray(of_tests(tests)).all()
            assert not np.asarray(of_tests(tuning)).any()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "fig5"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue.EXPERIMENTS, "fig5", replace(catalogue.EXPERIMENTS["fig5"], full=lambda: TINY))
        catalogue.reproduce("fig5", out=out, console=Console(quiet=True))
    return out


@pytest.mark.slow
class TestRun:
    """Two trainings, a learner and six rules to compile: more than a minute."""

    def test_every_arm_of_both_panels_is_there(self, folder):
        returns = np.load(folder / "returns.npz")
        for panel, arms in (("left", list(RULES)), ("right", ARMS)):
            for arm in arms:
                for name in (f"{panel}/{arm}", f"{panel}/{arm}/discounted_return"):
                    assert returns[name].shape == (2, 3, 3)
        for name, values in returns.items():
            assert 0 <= values.min() <= values.max() <= 1, name
            if not name.endswith("discounted_return"):
                assert set(np.unique(values)) <= {0.0, 1.0}

    def test_results_follow_from_the_returns(self, folder):
        results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        returns = np.load(folder / "returns.npz")
        assert list(results["panels"]) == ["left", "right"]
        for panel, entry in results["panels"].items():
            for name, arm in entry["arms"].items():
                runs = returns[f"{panel}/{name}"].reshape(6, -1)
                np.testing.assert_allclose(arm["median"], np.median(runs, axis=0))
                np.testing.assert_allclose(arm["mean_over_evaluations"], runs.mean(), rtol=1e-6)
                solved = [update for update, value in zip(arm["updates"], arm["median"], strict=True) if value >= 1]
                assert arm["first_median_solved"] == (solved[0] if solved else None)
                discounted = returns[f"{panel}/{name}/discounted_return"].reshape(6, -1)
                np.testing.assert_allclose(arm["discounted_return"]["median"], np.median(discounted, axis=0))
        for row in results["priors"]:
            for name in ("zero_shot_mean", "rank_correlation", "action_optimality"):
                assert name in row
                assert f"multi_task_{name}" in row

    def test_arms_share_their_start(self, folder):
        returns = np.load(folder / "returns.npz")
        for panel, arms in (("left", RULES), ("right", ARMS)):
            first = returns[f"{panel}/{next(iter(arms))}"][..., 0]
            for arm in arms:
                np.testing.assert_array_equal(returns[f"{panel}/{arm}"][..., 0], first)

    def test_the_same_again_gives_the_same_bits(self, folder):
        shown = []
        again = grid_figure(TINY, session=Session(show=shown.append))
        assert [(list(so_far.panels), so_far.pending) for so_far in shown] == [(["right"], ("left",))]
        assert shown[0].panels["right"] is again.panels["right"]
        assert (list(again.panels), again.pending) == (["left", "right"], ())
        returns = np.load(folder / "returns.npz")
        for name, panel in again.panels.items():
            for arm, curves in panel.arms.items():
                np.testing.assert_array_equal(curves.returns, returns[f"{name}/{arm}"])

    def test_the_left_panel_alone_is_the_same_and_needs_no_control(self, folder, tmp_path, monkeypatch):
        monkeypatch.setitem(catalogue.EXPERIMENTS, "fig5", replace(catalogue.EXPERIMENTS["fig5"], full=lambda: TINY))
        catalogue.reproduce("fig5", panels=["left"], out=tmp_path / "left", console=Console(quiet=True))
        alone, both = (np.load(path / "returns.npz") for path in (tmp_path / "left", folder))
        assert set(alone) == {name for name in both if not name.startswith("right/")}
        for name, values in alone.items():
            np.testing.assert_array_equal(values, both[name])
        results = json.loads((tmp_path / "left" / "results.json").read_text(encoding="utf-8"))
        assert results["training"]["iterations"] == [0, 2], "nothing is learned that no stop needs"
        assert "multi_task_returns" not in results["training"]
        assert not [name for row in results["priors"] for name in row if name.startswith("multi_task")]
        assert "multi-task DQN" not in (tmp_path / "left" / "report.html").read_text(encoding="utf-8")

    def test_pictures_and_report(self, folder):
        assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
        page = (folder / "report.html").read_text(encoding="utf-8")
        assert "Figure 5" in page
        assert "3 maps" in page
        assert page.count("<table>") == 2

    def test_priors_of_another_folder_are_taken_as_they_are(self, folder, tmp_path):
        with pytest.MonkeyPatch.context() as patch:
            shorter = replace(catalogue.EXPERIMENTS["fig5"], full=lambda: replace(TINY, dqn_updates=2))
            patch.setitem(catalogue.EXPERIMENTS, "fig5", shorter)
            catalogue.reproduce(
                "fig5", out=tmp_path / "again", panels=["right"], priors_of=folder, console=Console(quiet=True)
            )
        trained = [path.name for path in (tmp_path / "again" / "checkpoints").iterdir() if "DQN" not in path.name]
        for name in trained:
            (file,), (source,) = (
                list((where / "checkpoints" / name).glob("*.safetensors")) for where in (tmp_path / "again", folder)
            )
            assert file.read_bytes() == source.read_bytes()
        assert len(trained) == 2
        before, after = (np.load(where / "returns.npz")["right/prior"] for where in (folder, tmp_path / "again"))
        np.testing.assert_array_equal(after, before[..., :2])

    def test_a_finished_figure_resumed_is_made_from_its_checkpoints(self, folder):
        before = np.load(folder / "returns.npz")["right/prior"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(catalogue.EXPERIMENTS, "fig5", replace(catalogue.EXPERIMENTS["fig5"], full=lambda: TINY))
            catalogue.reproduce("fig5", out=folder, console=Console(quiet=True), resume=True)
        np.testing.assert_array_equal(np.load(folder / "returns.npz")["right/prior"], before)
