"""How results are summed up: median and quartiles (the paper's), IQM with stratified bootstrap intervals."""

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

    Each resample draws, for every task on its own, as many seeds as there are, with replacement.
    """
    seeds, tasks, evaluations = scores.shape
    rng = np.random.default_rng(seed)
    # How often each run is drawn says all: a run drawn twice counts twice in the sorted order.
    drawn = rng.multinomial(seeds, np.full(seeds, 1 / seeds), size=(samples, tasks))
    counts = np.swapaxes(drawn, 1, 2).reshape(samples, seeds * tasks)
    runs = _runs(scores)
    resampled = np.stack([_weighted_iqm(runs[:, index], counts) for index in range(evaluations)], axis=1)
    tail = 50 * (1 - confidence)
    low, high = np.percentile(resampled, [tail, 100 - tail], axis=0)
    return Interval(interquartile_mean(scores), low, high)


def _weighted_iqm(
    values: Float[np.ndarray, "runs"], counts: Int[np.ndarray, "samples runs"]
) -> Float[np.ndarray, "samples"]:
    """The interquartile mean of each resample in which run r stands ``counts[:, r]`` times."""
    order = np.argsort(values)
    until = np.cumsum(counts[:, order], axis=1)
    trimmed = values.size // 4
    below, above = trimmed, values.size - trimmed
    upto = np.clip(until, below, above)
    kept = np.diff(upto, axis=1, prepend=below)
    return kept @ values[order] / (above - below)


class Difference(NamedTuple):
    """A mean difference with the bounds of its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def paired_difference(ours: Scores, theirs: Scores, *, samples: int = 2000, seed: int = 0) -> Difference:
    """Ours less theirs, mean over all runs and evaluations; the two share seeds and tasks.

    The interval is of a bootstrap over tasks and over seeds: what other tasks and other priors might have shown.
    """
    of_runs = (np.asarray(ours, float) - np.asarray(theirs, float)).mean(axis=2)
    rng = np.random.default_rng(seed)
    # How often each is drawn, as a share: a resample's mean is then a product with the table of differences.
    seeds, tasks = (rng.multinomial(n, np.full(n, 1 / n), size=samples) / n for n in of_runs.shape)
    resampled = np.einsum("bs,st,bt->b", seeds, of_runs, tasks)
    low, high = np.percentile(resampled, [2.5, 97.5])
    return Difference(float(of_runs.mean()), float(low), float(high))


def first_at_least(updates: np.ndarray, curve: Curve, threshold: float) -> int | None:
    """The first number of updates at which the curve is at or above the threshold; None if it never is."""
    reached = np.flatnonzero(curve >= threshold)
    return int(updates[reached[0]]) if reached.size else None


def _runs(scores: Scores) -> Float[np.ndarray, "runs evaluations"]:
    return np.asarray(scores).reshape(-1, scores.shape[-1])
