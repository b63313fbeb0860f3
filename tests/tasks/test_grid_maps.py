"""Maps: reachable, of the right density, distinct, and split so that no test map or goal is in the training set."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from support.comparing import assert_trees_identical
from support.plain_grids import as_board, distances, draw, pick
from upslope.errors import UpslopeError
from upslope.tasks import clean_maps, grid_games, obstacle_maps
from upslope.tasks.grid_maps import fingerprint, held_out_goals, is_test_map, reachable

are_test_maps, fingerprints = (jax.jit(jax.vmap(function)) for function in (is_test_map, fingerprint))


#: Sums of the fingerprints of the paper's training maps.
GOLDEN_OBSTACLES, GOLDEN_CLEAN = 3171027173, 2163742591


def rows(maps):
    """Each map as a hashable tuple of its contents."""
    parts = [
        np.asarray(leaf).reshape(len(maps.start), -1) for leaf in (maps.obstacles, maps.traps, maps.start, maps.goal)
    ]
    return [tuple(row) for row in np.concatenate(parts, axis=1).astype(int).tolist()]


@pytest.fixture(scope="module")
def training():
    return obstacle_maps("train").sample_params.maps


@pytest.fixture(scope="module")
def clean_training():
    return clean_maps("train").sample_params.maps


@pytest.fixture(scope="module")
def clean():
    return draw(clean_maps(), 20_000)


@pytest.fixture(scope="module")
def unseen():
    return draw(obstacle_maps("test"), 2000, seed=1)


class TestReachability:
    @pytest.mark.parametrize(
        "family",
        [
            obstacle_maps(),
            grid_games((6, 9), obstacles=0.45),
            grid_games((7, 7), obstacles=0.2, traps=0.3),
            grid_games((4, 4), obstacles=0.97),
            grid_games((1, 2), obstacles=0.5),
            grid_games((5, 1), obstacles=0.6, split="test", held_out="goals"),
        ],
        ids=["8x8", "dense", "traps", "nearly full", "two cells", "a column with held-out goals"],
    )
    def test_breadth_first_search_finds_the_goal_from_every_start(self, family):
        maps = draw(family, 60)
        for index in range(60):
            one = pick(maps, index)
            board, start = as_board(one), divmod(int(one.start), family.env.width)
            assert distances(board)[start] > 0
            assert board[start[0]][start[1]] == "."

    def test_flood_fill_by_hand(self):
        free = jnp.asarray([[True, False, True], [True, False, True], [True, True, False]])
        expected = [[True, False, False], [True, False, False], [True, True, False]]
        np.testing.assert_array_equal(reachable(free, jnp.asarray(7)), expected)


class TestDistribution:
    def test_obstacles_keep_their_density(self, training):
        assert training.obstacles.shape == (4000, 8, 8)
        assert float(training.obstacles.mean()) == pytest.approx(0.2, abs=0.0032)  # 4 standard deviations
        per_cell = np.asarray(training.obstacles.mean(axis=0))
        np.testing.assert_allclose(per_cell, 0.2, atol=0.028)

    def test_traps_keep_their_density_among_the_free_cells(self):
        maps = draw(grid_games(traps=0.25), 2000)
        assert float(maps.obstacles.mean()) == pytest.approx(0.2, abs=0.006)
        assert float(maps.traps.mean()) == pytest.approx(0.8 * 0.25, abs=0.006)
        assert not np.any(maps.obstacles & maps.traps)

    def test_clean_maps_are_empty_and_their_starts_and_goals_uniform(self, clean):
        assert not np.any(clean.obstacles)
        assert np.all(clean.start != clean.goal)
        for ends in (clean.start, clean.goal):
            np.testing.assert_allclose(np.bincount(ends, minlength=100) / 20_000, 0.01, atol=0.0035)

    def test_other_keys_draw_other_maps(self):
        one, two = (rows(draw(obstacle_maps(), 60, seed)) for seed in range(2))
        assert len(set(one + two)) == 120


class TestFixedSets:
    def test_the_papers_sizes_all_distinct(self, training, clean_training):
        assert len(set(rows(training))) == 4000
        assert clean_training.obstacles.shape == (800, 10, 10)
        assert len(set(rows(clean_training))) == 800

    def test_a_family_of_fixed_maps_draws_exactly_those_maps(self):
        family = grid_games((4, 4), maps=5, maps_seed=3)
        drawn = rows(draw(family, 200))
        assert set(drawn) == set(rows(family.sample_params.maps))
        assert len(set(drawn)) == 5

    def test_the_same_seed_gives_the_same_maps(self):
        first, again, other = (grid_games((4, 4), maps=6, maps_seed=seed).sample_params.maps for seed in (1, 1, 2))
        assert_trees_identical(first, again)
        assert rows(first) != rows(other)

    def test_the_papers_sets_never_change(self, training, clean_training):
        # Published results are for exactly these maps.
        assert int(jnp.sum(fingerprints(training), dtype=jnp.uint32)) == GOLDEN_OBSTACLES
        assert int(jnp.sum(fingerprints(clean_training), dtype=jnp.uint32)) == GOLDEN_CLEAN

    def test_requesting_more_maps_than_exist(self):
        with pytest.raises(UpslopeError, match=r"Only 12 distinct maps were found where 13"):
            grid_games((2, 2), obstacles=0.0, maps=13)
        assert len(set(rows(grid_games((2, 2), obstacles=0.0, maps=12).sample_params.maps))) == 12


class TestSplits:
    def test_no_test_map_is_a_training_map(self, training, unseen):
        assert not set(rows(training)) & set(rows(unseen))
        assert np.all(are_test_maps(unseen))
        assert not np.any(are_test_maps(training))

    def test_test_maps_are_like_training_maps(self, unseen):
        assert float(unseen.obstacles.mean()) == pytest.approx(0.2, abs=0.0045)
        assert len(set(rows(unseen))) == 2000

    def test_a_fifth_of_all_maps_are_test_maps(self, clean):
        assert float(are_test_maps(clean).mean()) == pytest.approx(0.2, abs=0.04)
        assert float(are_test_maps(draw(grid_games(), 2000)).mean()) == pytest.approx(0.2, abs=0.04)

    @pytest.mark.slow
    def test_clean_splits_share_no_map(self, clean_training):
        assert not set(rows(clean_training)) & set(rows(draw(clean_maps("test"), 1000)))

    def test_held_out_goals_are_not_in_the_training_set(self):
        train, test = (clean_maps(split, held_out="goals") for split in ("train", "test"))
        trained = set(np.asarray(train.sample_params.maps.goal).tolist())
        tested = set(np.asarray(draw(test, 1000).goal).tolist())
        assert len(trained) == 80
        assert len(tested) == 20
        assert not trained & tested
        assert tested == set(np.flatnonzero(held_out_goals(10, 10)).tolist())

    @pytest.mark.slow
    def test_held_out_goals_on_maps_with_obstacles(self):
        train, test = (draw(grid_games(split=split, held_out="goals"), 500) for split in ("train", "test"))
        assert not set(train.goal.tolist()) & set(test.goal.tolist())

    def test_the_hash_depends_on_everything_on_the_map(self):
        one = pick(draw(grid_games(traps=0.2), 1), 0)
        cell = jnp.asarray((int(one.start) + 1) % 64)
        changed = [
            {"obstacles": one.obstacles.at[0, 0].set(~one.obstacles[0, 0])},
            {"traps": one.traps.at[0, 0].set(~one.traps[0, 0])},
            {"start": cell},
            {"goal": (one.goal + 1) % 64},
        ]
        prints = {int(fingerprint(one))} | {int(fingerprint(dataclasses.replace(one, **change))) for change in changed}
        assert len(prints) == 5
