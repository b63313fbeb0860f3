"""Summary statistics: median and quartiles (as in the paper), IQM with stratified bootstrap intervals."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import trim_mean

Scores = Float[np.ndarray, "seeds tasks evaluations"]
Curve = Float[np.ndarray, "evaluations"]


class Quartiles(NamedTuple):
    """Lower quartile, median and upper quartile at each evaluation."""

    q1: Curve
    median: Curve
    q3: Curve


class Interval(NamedTuple):
    """The interquartile mean at each evaluation, with the bounds of its 95 % bootstrap interval."""

    iqm: Curve
    low: Curve
    high: Curve


def quartiles(scores: Scores) -> Quartiles:
    """Over all seeds and tasks together, at each evaluation."""
    q1, median, q3 = np.percentile(_runs(scores), [25, 50, 75], axis=0)
    return Quartiles(q1, median, q3)


def interquartile_mean(scores: Scores) -> Curve:
    """The mean of the middle half of all runs, at each evaluation."""
    return trim_mean(_runs(scores), 0.25, axis=0)


def bootstrap(scores: Scores, *, samples: int = 2000, confidence: float = 0.95, seed: int = 0) -> Interval:
    """The interquartile mean with a percentile bootstrap interval, stratified by task.

    Each resample draws the seeds with replacement, separately for every task.
    """
    seeds, tasks, evaluations = scores.shape
    rng = np.random.default_rng(seed)
    # Only the number of draws of each run matters: a run drawn twice counts twice in the sorted order.
    draws = rng.multinomial(seeds, np.full(seeds, 1 / seeds), size=(samples, tasks))
    counts = np.swapaxes(draws, 1, 2).reshape(samples, seeds * tasks)
    runs = _runs(scores)
    resampled = np.stack([_weighted_iqm(runs[:, index], counts) for index in range(evaluations)], axis=1)
    tail = 50 * (1 - confidence)
    low, high = np.percentile(resampled, [tail, 100 - tail], axis=0)
    return Interval(interquartile_mean(scores), low, high)


def _weighted_iqm(
    values: Float[np.ndarray, "runs"], counts: Int[np.ndarray, "samples runs"]
) -> Float[np.ndarray, "samples"]:
    """The interquartile mean of each resample, which contains run r ``counts[:, r]`` times."""
    order = np.argsort(values)
    cumulative = np.cumsum(counts[:, order], axis=1)
    trimmed = values.size // 4
    below, above = trimmed, values.size - trimmed
    clipped = np.clip(cumulative, below, above)
    weights = np.diff(clipped, axis=1, prepend=below)
    return weights @ values[order] / (above - below)


class Difference(NamedTuple):
    """A mean difference with the bounds of its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def paired_difference(ours: Scores, theirs: Scores, *, samples: int = 2000, seed: int = 0) -> Difference:
    """Ours minus theirs, averaged over all runs and evaluations; both share seeds and tasks.

    The interval is of a bootstrap over tasks and over seeds, because other tasks and other priors would give other
    results.
    """
    of_runs = _mean_of_runs(np.asarray(ours, float) - np.asarray(theirs, float))
    (resampled,) = _resampled_means(of_runs, samples=samples, seed=seed)
    low, high = np.percentile(resampled, [2.5, 97.5])
    return Difference(float(of_runs.mean()), float(low), float(high))


class Shortfall(NamedTuple):
    """Percentage by which one mean is below another, its 95 % bootstrap interval, and the percentage of each seed."""

    percent: float
    low: float
    high: float
    of_seeds: list[float]


def paired_shortfall(ours: Scores, theirs: Scores, *, samples: int = 2000, seed: int = 0) -> Shortfall | None:
    """By how many percent our mean is below theirs; both are resampled together, as in `paired_difference`.

    None if their mean is not positive in every resample and for every seed: then percentages have no meaning.
    """
    means = _mean_of_runs(ours), _mean_of_runs(theirs)
    our_means, their_means = _resampled_means(*means, samples=samples, seed=seed)
    our_seeds, their_seeds = (of_runs.mean(axis=1) for of_runs in means)
    if min(their_means.min(), their_seeds.min()) <= 0:
        return None
    low, high = np.percentile(100 * (1 - our_means / their_means), [2.5, 97.5])
    percent = 100 * (1 - means[0].mean() / means[1].mean())
    return Shortfall(float(percent), float(low), float(high), (100 * (1 - our_seeds / their_seeds)).tolist())


def _mean_of_runs(scores: Scores) -> Float[np.ndarray, "seeds tasks"]:
    return np.asarray(scores, float).mean(axis=2)


def _resampled_means(
    *tables: Float[np.ndarray, "seeds tasks"], samples: int, seed: int
) -> list[Float[np.ndarray, "samples"]]:
    """The mean of each table over seeds and over tasks drawn with replacement, the same draws for all tables."""
    rng = np.random.default_rng(seed)
    # The share of draws of each seed and task: a resample's mean is then a product with the table.
    seeds, tasks = (rng.multinomial(n, np.full(n, 1 / n), size=samples) / n for n in tables[0].shape)
    return [np.einsum("bs,st,bt->b", seeds, table, tasks) for table in tables]


def first_at_least(updates: np.ndarray, curve: Curve, threshold: float) -> int | None:
    """The first number of updates at which the curve is at or above the threshold; None if it never is."""
    reached = np.flatnonzero(curve >= threshold)
    return int(updates[reached[0]]) if reached.size else None


def _runs(scores: Scores) -> Float[np.ndarray, "runs evaluations"]:
    return np.asarray(scores).reshape(-1, scores.shape[-1])
