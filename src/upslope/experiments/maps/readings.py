"""The priors of grid games: those of Figures 2 and 4, other readings of Algorithm 1, and fewer bits."""

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import HeadsPosterior, WeightsPosterior
from upslope.meta_training.recipes import ITERATIONS, for_grid_games, multi_task_dqn

Maps = Literal["obstacles", "clean"]

#: The measures with an aim, and the project's aims for Algorithm 1 on unseen maps.
AIMS: dict[str, dict[Maps, float]] = {
    "rank_correlation": {"obstacles": 0.95, "clean": 0.97},
    "action_optimality": {"obstacles": 0.88, "clean": 0.9},
    "success": {"obstacles": 0.7, "clean": 0.9},
}


class Reading(NamedTuple):
    """One way to learn a prior: a label and the settings."""

    label: str
    config: MetaTrainingConfig


@dataclass(frozen=True)
class GridPriorsConfig:
    """Which priors are learned, and on which maps they are measured.

    Attributes:
        maps: "obstacles" (8 × 8, 4,000 training maps) or "clean" (10 × 10, 800 training maps; no test goal is ever a
            training goal).
        readings: the readings by name.
        seeds: the number of priors of each reading.
        first_seed: seeds are first_seed, first_seed + 1, …; it also determines the test maps.
        tasks: the number of unseen maps.
    """

    maps: Maps
    readings: dict[str, Reading]
    seeds: int = 5
    first_seed: int = 0
    tasks: int = 100


def grid_priors(maps: Maps, iterations: int | None = None) -> GridPriorsConfig:
    """The recipe, and plain multi-task DQN for the same number of iterations, which take a little longer."""
    iterations = ITERATIONS[maps] if iterations is None else iterations
    return GridPriorsConfig(
        maps,
        {
            "algorithm1": Reading("Algorithm 1, φ a table, N = 30", for_grid_games(iterations)),
            "multi_task_dqn": Reading("multi-task DQN", multi_task_dqn(iterations)),
        },
    )


def grid_readings(iterations: int = 1500) -> GridPriorsConfig:
    """Other readings of Algorithm 1, and plain multi-task DQN: each for as long as the recipe's iterations take."""
    recipe = for_grid_games(iterations)
    # These readings need two or more passes through the network; the factors make the times equal (medians on two
    # quiet cores).
    one_pass_more, three_more = (
        for_grid_games(max(1, iterations * 6 // 11)),
        for_grid_games(max(1, iterations * 3 // 10)),
    )
    weights: dict[str, Any] = {"environments": 16, "reward_weight": 5.0, "advantage_weight": 30.0}
    normalised = weights | {"inner_step_size": 0.5, "normalised_steps": True}
    return GridPriorsConfig(
        "obstacles",
        {
            "algorithm1": Reading("φ a table, N = 30", recipe),
            "three_steps": Reading("φ a table, N = 3", recipe.with_posterior(inner_steps=3)),
            "one_step": Reading("φ a table, N = 1", recipe.with_posterior(inner_steps=1)),
            "one_each": Reading("a φ for each pair, N = 1", recipe.with_posterior(inner_steps=1, inner_step_size=0.5)),
            "unweighted": Reading("φ a table, N = 30, Eq. 7 alone", recipe.with_posterior(advantage_weight=0.0)),
            "heads": Reading(
                "φ the heads, N = 30, normalised",
                replace(recipe, posterior=HeadsPosterior(inner_steps=30, **normalised)),
            ),
            "heads_fixed": Reading(
                "φ the heads, N = 30, α = 0.1",
                replace(recipe, posterior=HeadsPosterior(inner_steps=30, inner_step_size=0.1, **weights)),
            ),
            "weights": Reading(
                "φ all weights, N = 1, normalised",
                replace(one_pass_more, posterior=WeightsPosterior(inner_steps=1, **normalised)),
            ),
            "weights_fixed": Reading(
                "φ all weights, N = 1, α = 0.01",
                replace(one_pass_more, posterior=WeightsPosterior(inner_steps=1, inner_step_size=0.01, **weights)),
            ),
            "weights_three": Reading(
                "φ all weights, N = 3, normalised",
                replace(three_more, posterior=WeightsPosterior(inner_steps=3, **normalised)),
            ),
            "multi_task_dqn": Reading("multi-task DQN", multi_task_dqn(max(1, iterations * 8 // 9))),
        },
        seeds=3,
    )


def grid_precisions(iterations: int = 1500) -> GridPriorsConfig:
    """The recipe with fewer bits in its convolutions; the effect on learning is the same on every machine."""
    recipe = for_grid_games(iterations)
    return GridPriorsConfig(
        "obstacles",
        {
            "algorithm1": Reading("float32", recipe),
            "tensorfloat32": Reading("TF32 in the convolutions", replace(recipe, precision="tensorfloat32")),
            "bfloat16": Reading("bfloat16 in the convolutions", replace(recipe, precision="bfloat16")),
        },
        seeds=1,
    )


def quick_grid_priors(config: GridPriorsConfig) -> GridPriorsConfig:
    """The quick form, a minute or two: tests the code, and its results mean nothing."""
    readings = {name: Reading(label, quick_reading(reading)) for name, (label, reading) in config.readings.items()}
    return replace(config, readings=readings, seeds=1, tasks=10)


def quick_reading(config: MetaTrainingConfig) -> MetaTrainingConfig:
    """The quick form of one training: at most a minute."""
    return replace(config, iterations=40, snapshot_every=20, evaluation_tasks=5)


def training_title(maps: Maps, reading: str) -> str:
    """The title of a reading's training, the same in every figure that uses it."""
    return f"{maps}: {reading}"
