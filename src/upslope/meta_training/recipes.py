"""Recipes of Algorithm 1: the one that works, which is the default, the paper to the letter, and maps."""

from collections.abc import Callable

from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors import NetworkPosterior, TablePosterior
from upslope.tasks.family import AbstractFamily


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


#: By the name that a family gives as its ``recipe``; families on the command line can have others by their own name.
RECIPES: dict[str, Callable[[], MetaTrainingConfig]] = {
    "vectors": MetaTrainingConfig,
    "images": MetaTrainingConfig,
    "maps": for_grid_games,
    "clean": lambda: for_grid_games(ITERATIONS["clean"]),
}


def suited_to(family: AbstractFamily) -> MetaTrainingConfig:
    """The recipe that a family names."""
    return RECIPES[family.recipe]()
