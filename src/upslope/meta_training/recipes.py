"""Recipes of Algorithm 1: one for any family, those of the paper's two families, and the paper to the letter."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior, TablePosterior, TrajectoryPosterior
from upslope.networks.torsos import torso_class
from upslope.tasks.family import AbstractFamily

#: Environment steps in each iteration, for each task.
_STEPS = 800


def for_any_family(family: AbstractFamily) -> MetaTrainingConfig:
    """Algorithm 1 for families that nobody has tuned anything for.

    φ_i is one Bellman backup along kept trajectories, numbers are normalised, and random actions are held.
    docs/deviations.md shows the measured effect of these choices.

    Args:
        family: episodes of up to 1,000 steps are collected whole; outer steps draw pieces of them, shorter ones where
            each state costs a convolution.
    """
    steps = min(max(family.max_steps, 200), 1000)
    is_costly = torso_class(family.observation_shape).takes_turns
    environments = max(1, round(_STEPS / steps))
    return MetaTrainingConfig(
        iterations=300,
        tasks=10,
        steps_per_task=steps,
        hidden=(256, 256),
        activation="relu",
        posterior=TrajectoryPosterior(environments=environments, drawn_steps=16 if is_costly else 50),
        outer_step_size=1e-3,
        outer_step_size_end=1e-4,
        outer_updates=16,
        epsilon=(0.02, 0.5),
        longest_hold=50,
        random_iterations=5,
        kept_iterations=25,
        normalise=True,
        evaluation_episodes=1,
    )


def for_poles() -> MetaTrainingConfig:
    """Algorithm 1 on poles, φ_i a network, as in Figure 1.

    `for_any_family` stays below 195 of 200 on poles (docs/deviations.md).
    """
    return MetaTrainingConfig()


def as_printed() -> MetaTrainingConfig:
    """Algorithm 1 to the letter; it collapses (docs/deviations.md).

    N = 1, one plain gradient step per iteration on the inner step's own samples, the graph kept on both sides of Eq. 7,
    no target network, one ε for all tasks, the last θ as the prior. β is the best of three that were tried.
    """
    return MetaTrainingConfig(
        activation="relu",
        outer_step_size=0.1,
        outer_step_size_end=0.1,
        outer_optimiser="sgd",
        outer_updates=1,
        posterior=NetworkPosterior(outer_target="kept", td_gradient="full", target_decay=None),
        epsilon=(0.1, 0.1),
        averaging=0.0,
        select_from=1.0,
    )


#: Meta-iterations on the paper's maps. Every clean training map is solved after a thousand.
ITERATIONS = {"obstacles": 8000, "clean": 3000}


def for_grid_games(iterations: int = ITERATIONS["obstacles"]) -> MetaTrainingConfig:
    """Algorithm 1 on grid games: φ_i a table, adapted by many steps on sixteen environments of each of two maps.

    docs/deviations.md shows the measured effect of these choices.
    """
    return MetaTrainingConfig(
        iterations=iterations,
        tasks=2,
        steps_per_task=50,
        hidden=(128, 128),
        activation="relu",
        posterior=TablePosterior(
            environments=16, inner_step_size=1.0, inner_steps=30, reward_weight=5.0, advantage_weight=30.0
        ),
        outer_step_size=0.002,
        outer_step_size_end=0.00002,
        outer_warmup=50,
        outer_updates=1,
        epsilon=(0.3, 1.0),
        averaging=0.998,
        select_from=1.0,
        snapshot_every=max(1, iterations // 16),
        evaluation_tasks=40,
        evaluation_episodes=1,
    )


def multi_task_dqn(iterations: int = ITERATIONS["obstacles"]) -> MetaTrainingConfig:
    """The control of `for_grid_games`: DQN over all maps, with a target network.

    One inner step of size one makes the posterior a Bellman backup of the target network, and Eq. 7 the loss of DQN.
    Network, experience, outer optimiser and ``reward_weight`` are those of the recipe, and were not tuned for it; each
    pair of state and action counts once, as there. Asking the target network makes its iterations 1.1 to 1.2 times as
    long.
    """
    return for_grid_games(iterations).with_posterior(inner_steps=1, target_decay=0.99, advantage_weight=0.0)


#: Recipes of single families, by the name that a family gives as its ``recipe``, or by its name on the command line.
RECIPES: dict[str, Callable[[], MetaTrainingConfig]] = {
    "poles": for_poles,
    "maps": for_grid_games,
    "clean": lambda: for_grid_games(ITERATIONS["clean"]),
}


def named(recipe: str, family: Callable[[], AbstractFamily]) -> MetaTrainingConfig:
    """The recipe of this name, or the one for any family; only for that one is the family made."""
    return RECIPES[recipe]() if recipe in RECIPES else for_any_family(family())


def recipe_for(family: AbstractFamily, **changes: Any) -> MetaTrainingConfig:
    """The settings with which `meta_train` trains on a family by default.

    Args:
        family: the distribution of tasks.
        changes: of single settings, such as ``iterations=1000``.
    """
    return replace(named(family.recipe, lambda: family), **changes)
