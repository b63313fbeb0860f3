"""Which priors of grid games are learned: each reading differs from the recipe in what it says, and in nothing else."""

import dataclasses

import jax
import matplotlib.image
import numpy as np

from upslope.experiments.maps.prior_plots import TITLES, draw_grid_priors
from upslope.experiments.maps.readings import grid_precisions, grid_readings, quick_grid_priors
from upslope.meta_training import MetaTraining
from upslope.tasks import obstacle_maps


def what_changes(readings):
    recipe = dataclasses.asdict(readings["algorithm1"].config)
    return {
        name: {key for key, value in dataclasses.asdict(config).items() if value != recipe[key]}
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
    """Eleven of them, the last of half as many iterations; single maps would only be a cloud."""
    curves = {measure: {"mean": [[0.1, 0.5, 0.9], [0.2, 0.6, 0.8]]} for measure in TITLES}
    rows = {f"reading {number}": {"what": f"no. {number}", "iterations": [0, 10, 20], "measures": curves,
                                  "maps": {"rank_correlation": [[0.5]]}} for number in range(11)}  # fmt: skip
    rows["reading 10"]["iterations"] = [0, 5, 10]
    draw_grid_priors({"readings": rows, "detours": [1.0]}, {"success": 0.7}, tmp_path)
    height, width, _ = matplotlib.image.imread(tmp_path / "figure.png").shape
    assert np.isclose(width / height, 3.4 * len(TITLES) / 3.2, rtol=0.02), "a panel for each measure, none for maps"
