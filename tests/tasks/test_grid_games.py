"""The family of grid games: settings that are refused, and every kind of learner running on it unchanged."""

import jax
import numpy as np
import pytest

from support.plain_grids import draw
from upslope import train
from upslope.envs.grid_rules import POSITION
from upslope.errors import UpslopeError
from upslope.learners.dqn import DQNConfig
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_any_family, for_grid_games, recipe_for
from upslope.tasks import FAMILIES, cartpoles, clean_maps, grid_games, obstacle_maps
from upslope.tasks.actions import DiscreteActions


class TestSettings:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"size": (1, 1)}, "1 × 1 cells holds no start and goal"),
            ({"size": (0, 8)}, "at least 2 cells"),
            ({"obstacles": 1.0}, "obstacles is 1.0"),
            ({"obstacles": float("nan")}, "obstacles is nan"),
            ({"traps": -0.1}, "traps is -0.1"),
            ({"slip": 1.5}, "slip is 1.5"),
            ({"trap_penalty": -1.0}, "trap_penalty is -1.0"),
            ({"trap_penalty": float("inf")}, "trap_penalty is inf"),
            ({"gamma": 0.0}, "gamma is 0.0"),
            ({"max_steps": 0}, "max_steps is 0"),
            ({"maps": 0}, "maps is 0"),
            ({"split": "train", "size": (2, 5)}, "too few maps to hold some out"),
        ],
        ids=str,
    )
    def test_bad_settings_are_refused(self, settings, message):
        with pytest.raises(UpslopeError, match=message):
            grid_games(**settings)

    def test_the_papers_families(self):
        clean, obstacles = clean_maps(), obstacle_maps()
        assert clean.observation_shape == (10, 10, 4)
        assert obstacles.observation_shape == (8, 8, 4)
        for family in (clean, obstacles):
            assert (family.actions, family.max_steps) == (DiscreteActions(4), 50)

    def test_traps_add_a_channel(self):
        assert grid_games(traps=0.1).observation_shape == (8, 8, 5)
        assert grid_games(traps=0.1, flat=True).observation_shape == (320,)

    def test_equal_settings_make_equal_families(self):
        assert grid_games() == grid_games()
        assert hash(grid_games()) == hash(grid_games())
        assert grid_games() != grid_games(slip=0.1)


SHORT = grid_games((5, 5), max_steps=7, gamma=0.8)


@pytest.fixture(scope="module")
def collected():
    tasks = draw(SHORT, 6)

    def policy(key, obs):
        return jax.random.randint(key, obs.shape[:1], 0, 4)

    @jax.jit
    def collect(key, tasks):
        return SHORT.collect(key, tasks, SHORT.reset(key, tasks), policy, 100)[1]

    return tasks, jax.tree.map(np.asarray, collect(jax.random.key(2), tasks))


class TestCollecting:
    def test_shapes(self, collected):
        _, batch = collected
        assert batch.obs.shape == batch.next_obs.shape == (6, 100, 5, 5, 4)
        assert batch.reward.shape == batch.discount.shape == batch.action.shape == (6, 100)

    def test_the_discount_is_zero_exactly_at_goals(self, collected):
        tasks, batch = collected
        arrived = batch.next_obs[..., POSITION].reshape(6, 100, 25).argmax(-1) == np.asarray(tasks.goal)[:, None]
        assert arrived.any()
        np.testing.assert_allclose(batch.discount, np.where(arrived, 0.0, 0.8), rtol=1e-6)
        np.testing.assert_array_equal(batch.reward, arrived.astype(float))

    def test_after_an_episode_the_next_one_begins_at_the_start(self, collected):
        tasks, batch = collected
        position = batch.obs[..., POSITION].reshape(6, 100, 25).argmax(-1)
        following = batch.next_obs[..., POSITION].reshape(6, 100, 25).argmax(-1)
        jumped = following[:, :-1] != position[:, 1:]
        assert jumped.any()
        starts = np.broadcast_to(np.asarray(tasks.start)[:, None], (6, 99))
        np.testing.assert_array_equal(position[:, 1:][jumped], starts[jumped])

    def test_the_return_is_one_where_the_goal_was_reached_and_zero_elsewhere(self):
        tasks = draw(clean_maps(), 50, seed=4)

        def down_then_right(key, obs):
            del key
            rows = obs[..., POSITION].sum(2).argmax(1)
            return np.int32(1) * (rows < 9) + np.int32(3) * (rows == 9)

        returns = jax.jit(lambda key, tasks: clean_maps().returns(key, tasks, down_then_right))(
            jax.random.key(0), tasks
        )
        row, column = np.divmod(np.asarray(tasks.start), 10)
        goal_row, goal_column = np.divmod(np.asarray(tasks.goal), 10)
        below = (goal_column == column) & (goal_row > row)
        along = (goal_row == 9) & (goal_column > column)
        np.testing.assert_array_equal(returns, (below | along).astype(float))
        assert 0 < returns.sum() < 50


class TestNamedFamilies:
    """The families by their names on the command line."""

    def test_every_family_has_its_name(self):
        assert FAMILIES["obstacles"]().build("test") == obstacle_maps("test")
        assert FAMILIES["clean"]().build("test") == clean_maps("test", held_out="goals")
        assert FAMILIES["cartpole"]().build() == cartpoles()
        assert FAMILIES["cartpole"](length=(1.0, 2.0)).build(actions="continuous") == cartpoles(
            (1.0, 2.0), continuous=True
        )
        assert FAMILIES["grid"](size=(5, 6), traps=0.1).build().observation_shape == (5, 6, 5)
        assert FAMILIES["grid"](gamma=0.8).build("train") == grid_games(gamma=0.8, split="train")

    @pytest.mark.parametrize("name", FAMILIES)
    def test_every_family_supplies_its_recipe(self, name):
        assert FAMILIES[name].recipe == FAMILIES[name]().build().recipe

    def test_the_length_of_a_pole_can_be_set(self):
        choice = FAMILIES["cartpole"].task_choice(pole=1.5)
        task, description = choice.task(cartpoles(), 0)
        assert float(task.length) == 1.5
        assert description == "a pole of 1.50 m"
        drawn, _ = FAMILIES["cartpole"].task_choice().task(cartpoles(), 0)
        assert 0.25 <= float(drawn.length) <= 5.0

    def test_the_seed_determines_the_map(self):
        family = grid_games()
        choice = FAMILIES["grid"].task_choice()
        (first, description), (again, _), (other, _) = (choice.task(family, seed) for seed in (3, 3, 4))
        assert description == "grid task 3"
        np.testing.assert_array_equal(first.obstacles, again.obstacles)
        assert not np.array_equal(first.obstacles, other.obstacles)

    def test_families_in_code_have_the_same_recipes(self):
        assert recipe_for(obstacle_maps()) == for_grid_games()
        assert recipe_for(cartpoles()) == MetaTrainingConfig()
        assert recipe_for(grid_games(flat=True)) == for_any_family(grid_games(flat=True))


@pytest.mark.slow
def test_a_dqn_with_an_mlp_learns_one_map():
    family = grid_games((4, 4), flat=True, maps=1, maps_seed=2)
    task = family.sample(jax.random.key(0))
    result = train(family, task, updates=600, every=300, config=DQNConfig(epsilon=0.5))
    assert result.returns[-1] == 1.0
