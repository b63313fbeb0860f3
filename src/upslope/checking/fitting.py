"""Which γ, scale and bias explain what a layer added to the rewards."""

from typing import NamedTuple

import numpy as np

from upslope.checking.evidence import Evidence
from upslope.equations.shaping import shaping_reward

#: Discounts above the one and scales below the other are artefacts of the least squares.
_LARGEST_GAMMA, _SMALLEST_SCALE = 2.0, 1e-6


class Fit(NamedTuple):
    """The γ and the potential c·Φ + b that ordinary steps were shaped with."""

    gamma: float
    scale: float = 1.0
    bias: float = 0.0


def fit_ordinary(ordinary: Evidence, gamma: float, tolerance: float) -> Fit | None:
    """The simplest γ, scale and bias that explain every ordinary step; None if none do."""
    if not len(ordinary.phi):
        return Fit(gamma)
    return next((fit for fit in _candidates(ordinary, gamma) if _explains(fit, ordinary, tolerance)), None)


def with_bias_of_ends(fit: Fit, evidence: Evidence, tolerance: float) -> Fit:
    """With γ = 1 a bias shows only at terminations, and all must agree on it."""
    over = evidence.take(evidence.terminated & ~evidence.dummy & ~evidence.first)
    if abs(fit.gamma - 1) > 1e-6 or len(over.phi) < 2:
        return fit
    biases = -over.added - fit.scale * over.phi
    return fit._replace(bias=float(np.mean(biases))) if np.ptp(biases) <= tolerance * max(1.0, fit.scale) else fit


def _explains(fit: Fit, ordinary: Evidence, tolerance: float) -> bool:
    if not (0 < fit.gamma <= _LARGEST_GAMMA and fit.scale > _SMALLEST_SCALE):
        return False
    psi, following = (fit.scale * leaf + fit.bias for leaf in (ordinary.phi, ordinary.successor))
    slack = tolerance * max(1.0, fit.scale) + 1e-5 * abs(fit.bias)
    return bool(np.all(np.abs(shaping_reward(psi, fit.gamma, following) - ordinary.added) <= slack))


def _candidates(ordinary: Evidence, gamma: float) -> list[Fit]:
    """From the simplest: as it should be, another γ, a scale, a scale and a bias, and all three."""
    phi, successor, added = ordinary.phi, ordinary.successor, ordinary.added
    plain = shaping_reward(phi, gamma, successor)
    candidates = [Fit(gamma)]
    if np.any(successor):
        candidates.append(Fit(float((added + phi) @ successor / (successor @ successor))))
    if np.any(plain):
        candidates.append(Fit(gamma, float(added @ plain / (plain @ plain))))
        columns = np.stack([plain, np.full_like(plain, gamma - 1)], axis=1)
        scale, bias = np.linalg.lstsq(columns, added, rcond=None)[0]
        candidates.append(Fit(gamma, float(scale), float(bias)))
        columns = np.stack([successor, phi, np.ones_like(phi)], axis=1)
        ahead, minus_scale, drip = np.linalg.lstsq(columns, added, rcond=None)[0]
        if minus_scale < 0:
            other = float(-ahead / minus_scale)
            # With γ = 1 a bias leaves no drip.
            bias = float(drip) / (other - 1) if abs(other - 1) > 1e-9 else 0.0
            candidates.append(Fit(other, float(-minus_scale), bias))
    return candidates
