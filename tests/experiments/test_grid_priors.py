"""The study of grid priors: what it measures, what it writes, what can be loaded again."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from rich.console import Console

from upslope.experiments import catalogue
from upslope.experiments.maps.priors import families, td_residual
from upslope.experiments.maps.readings import GridPriorsConfig, Reading
from upslope.meta_training.recipes import for_grid_games
from upslope.planning.measures import Measures, truths
from upslope.priors.prior import Prior

#: Every test here needs two small trainings, half a minute on a slow core.
pytestmark = pytest.mark.slow


def tiny():
    reading = dataclasses.replace(
        for_grid_games(2).with_posterior(environments=2),
        hidden=(8, 8),
        steps_per_task=20,
        snapshot_every=1,
        evaluation_tasks=2,
    )
    return GridPriorsConfig("obstacles", {"algorithm1": Reading("tiny", reading)}, seeds=1, tasks=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "priors"
    with pytest.MonkeyPatch.context() as patch:
        fig4 = dataclasses.replace(catalogue.EXPERIMENTS["fig4"], full=tiny)
        patch.setitem(catalogue.EXPERIMENTS, "fig4", fig4)
        catalogue.reproduce("fig4", out=out, console=Console(quiet=True), tasks=3)
    return out


@pytest.fixture(scope="module")
def row(folder):
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))["readings"]["algorithm1"]


def test_curves_have_a_point_for_every_snapshot(row):
    assert row["iterations"] == [0, 1, 2]
    for measure in ("rank_correlation", "squared_error", "action_optimality", "success", "discounted_return"):
        for kind in ("mean", "median", "worst"):
            assert np.shape(row["measures"][measure][kind]) == (1, 3)
    for measure in ("td_residual", "feature_norm", "dead_units"):
        assert np.shape(row["measures"][measure]["mean"]) == (1, 3)
    assert row["final"]["td_residual"] == [row["measures"]["td_residual"]["mean"][0][-1]]


@pytest.mark.parametrize("picture", ["figure.png", "figure.pdf", "map.png", "map.pdf", "sheet.png", "sheet.pdf"])
def test_pictures_are_drawn(folder, picture):
    assert (folder / picture).stat().st_size > 5000


def test_the_page_tells_whether_aims_are_met_and_holds_the_pictures(folder, row):
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<h1>Figure 4: learned V on maps with obstacles</h1>" in page
    assert page.count("data:image/png;base64,") == 3
    assert "quick form" not in page
    assert f"Zero-shot success: {row['final']['success'][0]:.4f} with Algorithm 1 (aim: 0.7, missed)." in page


def test_every_measure_of_single_maps_is_kept(folder, row):
    maps = np.load(folder / "maps.npz")
    assert set(maps) == {"detours"} | {f"algorithm1/{measure}" for measure in Measures._fields}
    for measure in ("rank_correlation", "squared_error", "action_optimality", "success", "discounted_return"):
        assert maps[f"algorithm1/{measure}"].shape == (1, 3)
        assert maps[f"algorithm1/{measure}"].mean() == pytest.approx(row["final"][measure][0], abs=1e-6)
    assert maps["algorithm1/success"].tolist() == row["maps"]["success"]
    assert set(row["maps"]) == {"rank_correlation", "success"}


def test_the_prior_on_disk_is_the_last_average(folder, row):
    prior = Prior.load(folder / "algorithm1-0.safetensors")
    family, _ = families("obstacles")
    prior.check(family, acting=True)
    assert prior.trained_on.settings["iteration"] == row["chosen"][0] == 2
    assert prior.trained_on.settings["posterior"]["name"] == "table"
    obs = family.env.observe_all(family.sample(jax.random.key(0)))
    assert np.isfinite(prior.values(obs)).all()


def test_td_residual():
    family, _ = families("obstacles")
    tasks = family.sample_many(jax.random.key(2), 1)
    known = jax.tree.map(lambda leaf: leaf[0], truths(family.env, tasks, family.gamma))
    value, q = known.solution.value, known.solution.action_value
    assert float(td_residual(known, value, q)) == pytest.approx(0, abs=1e-9)
    assert float(td_residual(known, value, q + 0.5)) == pytest.approx(0.25, rel=1e-4)


def test_training_and_test_goals_of_clean_maps_are_apart():
    train, test = families("clean")
    goals = set(np.asarray(train.sample_params.maps.goal).tolist())
    unseen = set(np.asarray(test.sample_many(jax.random.key(0), 100).goal).tolist())
    assert len(goals) > 50
    assert not goals & unseen


def test_single_maps_are_listed_with_their_detours(row, folder):
    assert np.shape(row["maps"]["rank_correlation"]) == np.shape(row["maps"]["success"]) == (1, 3)
    assert np.mean(row["maps"]["rank_correlation"][0]) == pytest.approx(row["final"]["rank_correlation"][0], abs=1e-6)
    detours = json.loads((folder / "results.json").read_text(encoding="utf-8"))["detours"]
    assert len(detours) == 3
    assert min(detours) >= 0
