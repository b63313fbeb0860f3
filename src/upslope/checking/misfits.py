"""Why rewards are shaped by Φ with no γ, scale and bias: clipped, changing with time, normalised, or something else."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from upslope.checking.evidence import Evidence
from upslope.checking.findings import Finding


class Clipping(NamedTuple):
    """Rewards that stop at a bound.

    Attributes:
        where: the transitions that the bound changed ``[n]``.
        words: what is clipped, and to what.
    """

    where: Bool[np.ndarray, "n"]
    words: str


def clippings(evidence: Evidence, expected: Float[np.ndarray, "n"], tolerance: float) -> list[Clipping]:
    """Where different values of F, or of R + F, became the same bound."""
    real = ~evidence.dummy
    wrong = real & (np.abs(evidence.added - expected) > tolerance)
    found = []
    for what, base in (("F", 0.0), ("R + F", evidence.below)):
        got, right = evidence.added + base, expected + base
        low, high = got[real].min(), got[real].max()
        at_bound = ((got >= high - tolerance) & (right > got)) | ((got <= low + tolerance) & (right < got))
        where = wrong & at_bound
        if np.sum(where) >= 2 and np.ptp(right[where]) > tolerance and not np.all(wrong[real]):
            found.append(Clipping(where, f"{what} never leaves {low:.4g} to {high:.4g}"))
    return found


def explain_misfit(evidence: Evidence, is_ordinary: Any, gamma: float, tolerance: float) -> Finding:
    """Why ordinary steps are not shaped by Φ with any γ, scale and bias."""
    ordinary = evidence.take(is_ordinary)
    added, expected = ordinary.added, ordinary.expected(gamma)
    wrong = np.abs(added - expected) > tolerance
    at = int(np.argmax(wrong))
    step, words = int(ordinary.step[at]), f"the reward was changed by {added[at]:.4g}, but F is {expected[at]:.4g} here"
    bounds = _clipped(ordinary, gamma, tolerance) or _clipped(evidence.take(~evidence.dummy), gamma, tolerance)
    if bounds:
        return Finding("clipped", step, f"{words}; {bounds}.")
    if _outlasts_episodes(wrong, ordinary) or _drifts(ordinary, gamma, tolerance):
        share = f"{np.mean(~wrong):.0%} of the steps fit Φ" if np.any(~wrong) else "the weight of Φ changes over time"
        return Finding("stale_mixture", step, f"{words}, although {share}: there is more than one version of Φ.")
    is_rescaled = np.mean(wrong) > 0.95 and np.std(added) > 0 and np.std(expected) > 0
    if is_rescaled and np.corrcoef(added, expected)[0, 1] > 0.7:
        return Finding(
            "normalised", step, f"{words}; the two are correlated, but no γ, scale and bias make them equal."
        )
    return Finding("not_potential_based", step, f"{words}, and no γ, scale and bias of Φ make the two equal.")


def _clipped(part: Evidence, gamma: float, tolerance: float) -> str:
    """The bounds that explain everything that is wrong; empty if none do."""
    expected = part.expected(gamma)
    wrong = np.abs(part.added - expected) > tolerance
    found = clippings(part, expected, tolerance)
    return next((clipping.words for clipping in found if np.all(clipping.where == wrong)), "")


def _outlasts_episodes(wrong: Bool[np.ndarray, "n"], ordinary: Evidence) -> bool:
    """Whether being right or wrong carries over from episode to episode, as it does if Φ changes over time.

    A bonus for states or actions starts again with every episode: there it changes as often as by chance.
    """
    across = np.diff(ordinary.age) > 1
    share = np.mean(wrong)
    changes, by_chance = np.sum((wrong[1:] != wrong[:-1])[across]), np.sum(across) * 2 * share * (1 - share)
    return bool(by_chance >= 5 and changes < 0.5 * by_chance)


def _drifts(ordinary: Evidence, gamma: float, tolerance: float) -> bool:
    """Whether a weight of Φ that changes over time explains most parts of the run.

    Wrappers of single environments count transitions; those of vector environments also count steps that only reset.
    """
    return any(_drifts_with(time, ordinary, gamma, tolerance) for time in (ordinary.age, ordinary.step))


def _drifts_with(times: Any, ordinary: Evidence, gamma: float, tolerance: float, window: int = 40) -> bool:
    explained = []
    for start in range(0, len(ordinary.phi) - window + 1, window):
        part, own = ordinary.take(slice(start, start + window)), times[start : start + window]
        if np.any(np.diff(own) <= 0):  # the next sub-environment begins
            continue
        time = (own - np.mean(own)) / np.ptp(own)
        columns = np.stack([part.successor, part.phi, time * part.successor, time * part.phi], axis=1)
        weights = np.linalg.lstsq(columns, part.added, rcond=None)[0]
        fits = np.all(np.abs(columns @ weights - part.added) <= 10 * tolerance)
        is_difference = weights[1] <= 0 and abs(weights[0] + gamma * weights[1]) <= 0.02 * abs(weights[0]) + tolerance
        explained.append(fits and is_difference)
    return bool(explained) and bool(np.mean(explained) > 0.7)
