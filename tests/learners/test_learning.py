"""The slow tier: real training, on seeds and tasks that were not used for tuning. `make test-slow` runs it."""

import jax
import numpy as np
import pytest

from upslope.experiments.keys import Purpose, key_for
from upslope.experiments.poles.figure1 import Figure1Config, figure1
from upslope.experiments.priors import meta_train_priors, zero_shot_returns
from upslope.experiments.results import FigureResult
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import as_printed, for_grid_games
from upslope.planning.measures import measure_all, truths
from upslope.tasks import cartpoles, obstacle_maps

pytestmark = pytest.mark.slow
FRESH = 500


@pytest.fixture(scope="module")
def figure() -> FigureResult:
    return figure1(Figure1Config(first_seed=FRESH, seeds=3, tasks=20))


def test_every_one_of_ten_priors_acts_well_before_learning() -> None:
    family = cartpoles()
    priors = meta_train_priors(family, MetaTrainingConfig(), FRESH, 10)
    tasks = family.sample_many(key_for(FRESH, Purpose.TEST_TASKS), 40)
    returns = np.asarray(zero_shot_returns(family, priors.final, tasks, key_for(FRESH, Purpose.ZERO_SHOT)))
    assert returns.mean(axis=1).min() >= 195


def test_algorithm_1_as_printed_collapses() -> None:
    """Documented in docs/deviations.md; if this ever fails, that page is wrong."""
    family = cartpoles()
    priors = meta_train_priors(family, as_printed(), FRESH, 5)
    tasks = family.sample_many(key_for(FRESH, Purpose.TEST_TASKS), 40)
    returns = np.asarray(zero_shot_returns(family, priors.final, tasks, key_for(FRESH, Purpose.ZERO_SHOT)))
    assert np.median(returns.mean(axis=1)) < 100


@pytest.mark.parametrize(("panel", "gain"), [("middle", 1.4), ("right", 1.7)])
def test_shaping_improves_learning(figure: FigureResult, panel: str, gain: float) -> None:
    means = {name: arm.returns.mean() for name, arm in figure.panels[panel].arms.items()}
    assert means["prior"] >= gain * means["unshaped"]
    assert means["prior"] >= 1.2 * means["constant"]


def test_algorithm_2_is_ahead_of_maml_from_a_half_trained_prior(figure: FigureResult) -> None:
    arms = figure.panels["left"].arms
    assert arms["algorithm2"].returns.mean() > arms["maml"].returns.mean()


def test_a_tenth_of_the_training_ranks_the_cells_of_unseen_maps() -> None:
    """600 iterations with their own schedule; measured means 0.51 and 0.43. An untrained V does not rank cells."""
    priors = meta_train_priors(obstacle_maps("train"), for_grid_games(600), FRESH, 2)
    unseen = obstacle_maps("test")
    maps = unseen.sample_many(key_for(FRESH, Purpose.TEST_TASKS), 40)
    known = truths(unseen.env, maps, unseen.gamma)
    for seed in range(2):
        network = jax.tree.map(lambda leaf, index=seed: leaf[index], priors.final)
        measures = measure_all(unseen.env, known, maps, network, unseen.max_steps)
        assert np.mean(measures.rank_correlation) >= 0.3
        assert np.mean(measures.action_optimality) >= 0.3
