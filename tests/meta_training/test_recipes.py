"""The recipe for any family: how it follows the family, and what it learns."""

import jax
import numpy as np
import pytest

import upslope
from support.corridor import corridors
from upslope.families.acrobots import acrobots
from upslope.families.mountain_cars import continuous_mountain_cars, mountain_cars
from upslope.families.reach import reach
from upslope.learners.policies import Greedy
from upslope.meta_training.recipes import for_any_family, for_grid_games, recipe_for
from upslope.tasks import cartpoles, grid_games


class TestSettings:
    @pytest.mark.parametrize(
        ("build", "steps", "environments"),
        [(corridors, 200, 4), (mountain_cars, 200, 4), (acrobots, 500, 2), (continuous_mountain_cars, 999, 1)],
    )
    def test_whole_episodes_and_800_steps_of_each_task(self, build, steps, environments):
        config = for_any_family(build())
        assert config.steps_per_task == steps
        assert config.posterior.environments == environments

    def test_pieces_are_shorter_where_a_state_costs_a_convolution(self):
        assert for_any_family(grid_games()).posterior.drawn_steps == 16
        assert for_any_family(corridors()).posterior.drawn_steps == 50

    def test_poles_and_maps_keep_their_own(self):
        assert recipe_for(cartpoles()) == upslope.MetaTrainingConfig()
        assert recipe_for(grid_games()) == for_grid_games()

    def test_single_settings_can_be_changed(self):
        config = recipe_for(corridors(), iterations=7, hidden=(8,))
        assert (config.iterations, config.hidden) == (7, (8,))
        assert config.longest_hold == for_any_family(corridors()).longest_hold


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "lowest"), [(mountain_cars, -120.0), (acrobots, -100.0), (reach, 1.0)], ids=["cars", "acrobots", "reach"]
)
def test_it_learns(build, lowest):
    """The median return of the prior's own policy on fresh tasks; the random policy's are −200, −500 and 0."""
    family = build()
    prior = upslope.meta_train(family, seed=0, progress=False)
    tasks = family.sample_many(jax.random.key(1234), 50)
    assert np.median(family.returns(jax.random.key(5), tasks, Greedy(prior.network))) >= lowest
