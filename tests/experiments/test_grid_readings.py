"""The priors of grid games: each reading differs from the recipe in what its label says, and in nothing else."""

import base64
import dataclasses
import re

import jax
import matplotlib.image
import numpy as np

from upslope.experiments.maps.prior_plots import TITLES, draw_grid_priors
from upslope.experiments.maps.prior_report import COLUMNS, about_aims, prior_rows, write_prior_report
from upslope.experiments.maps.readings import grid_precisions, grid_readings, quick_grid_priors
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.tasks import obstacle_maps


def what_changes(readings):
    """The settings of each reading that differ from the recipe's, those of its posterior included."""

    def flat(config):
        settings = dataclasses.asdict(config)
        posterior = settings.pop("posterior")
        return {"normalised_steps": False, "posterior": posterior.pop("name")} | settings | posterior

    recipe = flat(readings["algorithm1"].config)
    return {
        name: {key for key, value in flat(config).items() if value != recipe[key]}
        for name, (_, config) in readings.items()
    }


def test_readings_change_what_they_say():
    changed = what_changes(grid_readings().readings)
    normalised, lengths = {"inner_step_size", "normalised_steps"}, {"iterations", "snapshot_every"}
    assert changed["three_steps"] == changed["one_step"] == {"inner_steps"}
    assert changed["one_each"] == {"inner_steps", "inner_step_size"}
    assert changed["heads"] == {"posterior"} | normalised
    assert changed["heads_fixed"] == {"posterior", "inner_step_size"}
    assert changed["weights"] == changed["weights_three"] == {"posterior", "inner_steps"} | normalised | lengths
    assert changed["weights_fixed"] == {"posterior", "inner_steps", "inner_step_size"} | lengths
    assert changed["unweighted"] == {"advantage_weight"}
    assert changed["multi_task_dqn"] == {"inner_steps", "target_decay", "advantage_weight"} | lengths
    assert all(reading.config.iterations == 40 for reading in quick_grid_priors(grid_readings()).readings.values())


def test_precisions_change_nothing_else():
    readings = grid_precisions().readings
    changed = what_changes(readings)
    assert changed == {"algorithm1": set(), "tensorfloat32": {"precision"}, "bfloat16": {"precision"}}
    network = jax.eval_shape(MetaTraining(obstacle_maps(), readings["bfloat16"].config).init, jax.random.key(0)).theta
    assert network.torso.precision == "bfloat16"


def test_readings_of_other_lengths_are_drawn_beside_each_other(tmp_path):
    """Eleven readings, the last with half as many iterations; there is no panel of single maps."""
    curves = {measure: {"mean": [[0.1, 0.5, 0.9], [0.2, 0.6, 0.8]]} for measure in TITLES}
    rows = {f"reading {number}": {"what": f"no. {number}", "iterations": [0, 10, 20], "measures": curves,
                                  "maps": {"rank_correlation": [[0.5]]}} for number in range(11)}  # fmt: skip
    rows["reading 10"]["iterations"] = [0, 5, 10]
    draw_grid_priors({"readings": rows, "detours": [1.0]}, {"success": 0.7}, tmp_path)
    height, width, _ = matplotlib.image.imread(tmp_path / "figure.png").shape
    assert np.isclose(width / height, 3.4 * len(TITLES) / 3.2, rtol=0.02), "a panel for each measure, none for maps"


FINAL = {
    "rank_correlation": [0.9, 1.0],
    "action_optimality": [0.5, 0.5],
    "success": [0.25, 0.5],
    "squared_error": [0.01, 0.03],
    "td_residual": [1.0, 3.0],
}
RESULTS = {
    "quick": False,
    "maps": "obstacles",
    "readings": {
        "algorithm1": {"what": "φ <b>", "seconds": [0.0, 61.4], "final": FINAL},
        "multi_task_dqn": {"what": "DQN", "seconds": [0.0, 2.0], "final": {name: [0.5] for name in TITLES}},
    },
    "seconds_compiling": 1.0,
    "seconds_running": 2.0,
    "configuration": {"seeds": 2, "tasks": 10, "first_seed": 3},
}
AIMS = {"rank_correlation": 0.95, "success": 0.4}


class TestPage:
    """Two seeds of Algorithm 1 and one of its control."""

    def test_rows_are_means_with_the_lowest_and_highest_seed(self):
        ours, theirs = prior_rows(RESULTS)
        assert ours[:3] == ("φ <b>", "61", "0.95 (0.9 to 1)")
        assert ours[3:] == (
            "0.5 (0.5 to 0.5)",
            "0.375 (0.25 to 0.5)",
            "0.02 (0.01 to 0.03)",
            "2 (1 to 3)",
        )
        assert theirs == ("DQN", "2", *["0.5"] * 5)
        assert len(COLUMNS) == len(ours)

    def test_aims_are_met_or_missed(self):
        assert about_aims(RESULTS, AIMS) == [
            "Rank correlation of V with V*: 0.9500 with Algorithm 1 (aim: 0.95, reached).",
            "Zero-shot success: 0.3750 with Algorithm 1 (aim: 0.4, missed).",
        ]

    def test_the_page_holds_the_pictures_that_are_there(self, tmp_path):
        for name in ("figure.png", "map.png", "sheet.png"):
            (tmp_path / name).write_bytes(name.encode())
        write_prior_report("Figure <4>", RESULTS, AIMS, tmp_path)
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        pictures = [base64.b64decode(data).decode() for data in re.findall(r"base64,([^\"]*)", page)]
        assert pictures == ["figure.png", "map.png", "sheet.png"]
        assert "<h1>Figure &lt;4&gt;</h1>" in page
        assert "<td>φ &lt;b&gt;</td><td>61</td>" in page
        assert "(aim: 0.4, missed)" in page
        assert "2 of each kind, and measured exactly on 10 unseen maps" in page
        assert "First seed: 3." in page
        assert "quick form" not in page
        write_prior_report("Figure 4", {**RESULTS, "quick": True}, AIMS, tmp_path)
        assert "quick form" in (tmp_path / "report.html").read_text(encoding="utf-8")
