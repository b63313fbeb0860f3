"""Summary statistics: quartiles and interquartile means by hand, bootstrap intervals, first crossings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upslope.experiments.statistics import (
    _weighted_iqm,
    bootstrap,
    first_at_least,
    interquartile_mean,
    paired_difference,
    paired_shortfall,
    quartiles,
)

#: Two seeds, four tasks, two evaluations: 1 to 8 at the first, ten times that at the second.
EIGHT = np.stack([np.arange(1.0, 9.0), 10 * np.arange(1.0, 9.0)], axis=-1).reshape(2, 4, 2)


def noisy_scores(seeds, tasks=3, spread=10.0):
    rng = np.random.default_rng(0)
    return 100 + spread * rng.normal(size=(seeds, tasks, 2))


class TestQuartiles:
    def test_by_hand(self):
        # Linear interpolation between the ranks 1 … 8: 1 + 7/4, 1 + 7/2, 1 + 21/4.
        result = quartiles(EIGHT)
        np.testing.assert_allclose(result.q1, [2.75, 27.5])
        np.testing.assert_allclose(result.median, [4.5, 45.0])
        np.testing.assert_allclose(result.q3, [6.25, 62.5])

    def test_seeds_and_tasks_count_alike(self):
        swapped = np.swapaxes(EIGHT, 0, 1)
        np.testing.assert_array_equal(quartiles(EIGHT), quartiles(swapped))


class TestInterquartileMean:
    def test_by_hand(self):
        np.testing.assert_allclose(interquartile_mean(EIGHT), [4.5, 45.0])  # of 3, 4, 5, 6

    def test_outliers_do_not_count(self):
        wild = EIGHT.copy()
        wild[0, 0], wild[1, 3] = -1e6, 1e6
        np.testing.assert_allclose(interquartile_mean(wild), [4.5, 45.0])

    def test_it_is_not_the_median(self):
        scores = np.array([0.0, 1.0, 1.0, 4.0]).reshape(2, 2, 1)
        np.testing.assert_allclose(interquartile_mean(scores), [1.0])
        scores = np.array([0.0, 0, 0, 4, 10, 10, 10, 10]).reshape(2, 4, 1)
        np.testing.assert_allclose(interquartile_mean(scores), [6.0])  # of 0, 4, 10, 10; the median is 7


class TestBootstrap:
    def test_the_interval_holds_the_interquartile_mean(self):
        scores = noisy_scores(10)
        interval = bootstrap(scores, samples=300)
        np.testing.assert_array_equal(interval.iqm, interquartile_mean(scores))
        assert np.all(interval.low < interval.iqm)
        assert np.all(interval.iqm < interval.high)

    def test_it_is_deterministic_in_its_seed(self):
        scores = noisy_scores(6)
        np.testing.assert_array_equal(bootstrap(scores, samples=100), bootstrap(scores, samples=100))
        assert not np.array_equal(bootstrap(scores, samples=100).low, bootstrap(scores, samples=100, seed=1).low)

    def test_it_shrinks_with_more_seeds(self):
        few, many = (bootstrap(noisy_scores(seeds), samples=300) for seeds in (5, 80))
        assert np.all(many.high - many.low < 0.5 * (few.high - few.low))

    def test_it_shrinks_with_less_confidence(self):
        sure, unsure = (bootstrap(noisy_scores(10), samples=300, confidence=c) for c in (0.99, 0.5))
        assert np.all(unsure.high - unsure.low < sure.high - sure.low)

    def test_it_is_stratified_by_task(self):
        # Tasks differ greatly, seeds do not: resampling seeds within tasks gives no width, resampling runs would.
        scores = np.broadcast_to(np.array([0.0, 50.0, 100.0])[None, :, None], (5, 3, 1)).copy()
        interval = bootstrap(scores, samples=50)
        assert interval.low[0] == interval.iqm[0] == interval.high[0]

    def test_each_task_draws_its_own_seeds(self):
        # Two tasks that mirror each other: whole seeds drawn for both would always give an interquartile mean of zero.
        scores = np.stack([np.arange(1.0, 6.0), -np.arange(1.0, 6.0)], axis=1)[..., None]
        interval = bootstrap(scores, samples=300)
        assert interval.iqm[0] == 0
        assert interval.low[0] < -0.5
        assert interval.high[0] > 0.5

    def test_a_whole_curve_is_resampled_together(self):
        scores = noisy_scores(6)
        scores[..., 1] = scores[..., 0]
        interval = bootstrap(scores, samples=50)
        assert interval.low[0] == interval.low[1]

    @given(st.integers(0, 1000))
    def test_counting_runs_equals_resampling_them(self, seed):
        rng = np.random.default_rng(seed)
        runs = rng.integers(0, 5, size=7).astype(float)  # with ties
        counts = rng.multinomial(7, np.full(7, 1 / 7), size=3)
        resampled = [interquartile_mean(np.repeat(runs, count)[:, None, None])[0] for count in counts]
        np.testing.assert_allclose(_weighted_iqm(runs, counts), resampled)

    @given(st.integers(0, 1000))
    def test_bounds_lie_within_the_scores(self, seed):
        scores = np.random.default_rng(seed).normal(size=(4, 2, 3))
        interval = bootstrap(scores, samples=20)
        assert np.all(interval.low <= interval.high)
        assert np.all(scores.min((0, 1)) <= interval.low)
        assert np.all(interval.high <= scores.max((0, 1)))


class TestFirstAtLeast:
    updates = np.array([0, 100, 200, 300])

    @pytest.mark.parametrize(
        ("threshold", "expected"),
        [(15.0, 100), (20.0, 100), (21.0, 300), (10.0, 0), (40.0, 300), (40.1, None)],
    )
    def test_by_hand(self, threshold, expected):
        curve = np.array([10.0, 20.0, 12.0, 40.0])
        assert first_at_least(self.updates, curve, threshold) == expected

    def test_it_is_a_plain_integer(self):
        assert type(first_at_least(self.updates, np.ones(4), 1.0)) is int


class TestPairedDifference:
    def test_by_hand(self):
        difference = paired_difference(EIGHT + 3, EIGHT)
        assert (difference.mean, difference.low, difference.high) == (3.0, 3.0, 3.0)

    def test_the_interval_is_over_tasks(self):
        # Seeds and evaluations are alike: of four tasks one is better by 4, so a resample's mean is 0, 1, 2, 3 or 4.
        ours = EIGHT.copy()
        ours[:, 2] += 4
        difference = paired_difference(ours, EIGHT)
        assert difference.mean == 1.0
        assert difference.low == 0.0
        assert difference.high == 3.0

    def test_the_interval_is_over_seeds_too(self):
        # Of two seeds one is better by 4 on every task: a resample's mean is 0, 2 or 4.
        ours = EIGHT.copy()
        ours[1] += 4
        difference = paired_difference(ours, EIGHT)
        assert (difference.mean, difference.low, difference.high) == pytest.approx((2.0, 0.0, 4.0))

    def test_it_covers_the_truth_about_as_often_as_it_says(self):
        rng = np.random.default_rng(1)
        hits = 0
        for trial in range(200):
            ours = rng.normal(0.5, 1.0, size=(1, 40, 1))
            found = paired_difference(ours, np.zeros_like(ours), samples=400, seed=trial)
            hits += found.low <= 0.5 <= found.high
        assert 180 <= hits <= 198


class TestPairedShortfall:
    def test_by_hand(self):
        shortfall = paired_shortfall(0.75 * EIGHT, EIGHT)
        assert shortfall[:3] == pytest.approx((25.0, 25.0, 25.0))
        assert shortfall.of_seeds == pytest.approx([25.0, 25.0])

    def test_it_is_of_means_and_not_a_mean_of_percents(self):
        # One task earns 1 instead of 2, the other 8 as before: a tenth of the sum is missing, and half of the first.
        ours, theirs = np.array([1.0, 8.0]).reshape(1, 2, 1), np.array([2.0, 8.0]).reshape(1, 2, 1)
        shortfall = paired_shortfall(ours, theirs)
        assert (shortfall.percent, shortfall.low, shortfall.high) == pytest.approx((10.0, 0.0, 50.0))

    def test_of_each_seed(self):
        theirs = np.ones((2, 3, 4))
        ours = theirs.copy()
        ours[0] = 0.5
        ours[1] = 1.25
        shortfall = paired_shortfall(ours, theirs)
        assert shortfall.of_seeds == pytest.approx([50.0, -25.0])
        assert (shortfall.percent, shortfall.low, shortfall.high) == pytest.approx((12.5, -25.0, 50.0))

    def test_the_draws_are_those_of_the_difference(self):
        rng = np.random.default_rng(0)
        ours, theirs = rng.uniform(0.5, 1.0, size=(5, 40, 3)), np.ones((5, 40, 3))
        difference, shortfall = paired_difference(ours, theirs), paired_shortfall(ours, theirs)
        assert shortfall[:3] == pytest.approx((-100 * difference.mean, -100 * difference.high, -100 * difference.low))

    def test_nothing_to_take_percents_of(self):
        assert paired_shortfall(np.ones((1, 2, 1)), np.zeros((1, 2, 1))) is None
        sometimes = np.array([0.0, 1.0]).reshape(1, 2, 1)
        assert paired_shortfall(np.ones((1, 2, 1)), sometimes) is None, "nothing in some resample"
        one_seed = np.array([0.0, 1.0]).reshape(2, 1, 1).repeat(2, axis=1)
        assert paired_shortfall(np.ones((2, 2, 1)), one_seed) is None, "nothing with one seed"
