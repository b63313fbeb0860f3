"""Judges whether what a layer added to the reward is potential-based, and if not, why not."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from upslope.checking.evidence import Evidence
from upslope.checking.findings import Finding
from upslope.checking.fitting import Fit, fit_ordinary, with_bias_of_ends
from upslope.checking.misfits import clippings, explain_misfit
from upslope.equations.shaping import shaping_reward


def judge(evidence: Evidence, gamma: float) -> list[Finding]:
    """All mistakes in the transitions; none if they are shaped by b + c·Φ with any b and any c > 0."""
    size = max(1e-9, float(np.nanmax(np.abs([evidence.phi, evidence.successor]))))
    tolerance = 1e-6 + 1e-5 * size  # wrappers may compute in single precision
    if np.all(np.abs(evidence.added) <= tolerance):
        return _never_applied(evidence, gamma, tolerance)
    is_ordinary = ~(evidence.terminated | evidence.truncated | evidence.dummy | evidence.first)
    ordinary = evidence.take(is_ordinary)
    fit = fit_ordinary(ordinary, gamma, tolerance)
    if fit is None:
        return [explain_misfit(evidence, is_ordinary, gamma, tolerance)]
    findings = []
    if abs(fit.gamma - gamma) > 1e-4:
        at = int(np.argmax(np.abs(ordinary.successor)))
        words = (
            f"F is {ordinary.added[at]:.4g} for Φ(s) = {ordinary.phi[at]:.4g} and Φ(s') = {ordinary.successor[at]:.4g}"
        )
        words += f", which is γ = {fit.gamma:.4g} and not {gamma:.4g}."
        findings.append(Finding("gamma_mismatch", int(ordinary.step[at]), words))
    fit = with_bias_of_ends(fit, evidence, tolerance)
    return findings + judge_ends(evidence, fit, tolerance * max(1.0, fit.scale))


def _never_applied(evidence: Evidence, gamma: float, tolerance: float) -> list[Finding]:
    expected = np.where(evidence.dummy, 0.0, evidence.expected(gamma))
    at = int(np.argmax(np.abs(expected)))
    if abs(expected[at]) <= 10 * tolerance:
        return []
    words = f"no reward was changed, but F is {expected[at]:.4g} here."
    return [Finding("never_applied", int(evidence.step[at]), words)]


class _Group(NamedTuple):
    """Transitions of one kind: what they must be paid, and what known mistakes would pay instead."""

    where: str
    of: Bool[np.ndarray, "n"]
    expected: Float[np.ndarray, "n"]
    mistakes: list[tuple[str, Float[np.ndarray, "n"]]]
    otherwise: str = "not_potential_based"


def judge_ends(evidence: Evidence, fit: Fit, tolerance: float) -> list[Finding]:
    """Mistakes at terminations, truncations, resets and first steps, with the γ and the level of ordinary steps."""
    phi, successor = (fit.scale * leaf + fit.bias for leaf in (evidence.phi, evidence.successor))
    right = shaping_reward(phi, fit.gamma, np.where(evidence.terminated, 0.0, successor))
    bounds = clippings(evidence, right, tolerance)
    findings: list[Finding] = []
    for where, of, expected, mistakes, otherwise in _groups(evidence, fit, tolerance):
        wrong = np.flatnonzero(of & (np.abs(evidence.added - expected) > tolerance))
        if not wrong.size:
            continue
        at = wrong[0]
        words = f"where {where}, the reward was changed by {evidence.added[at]:.4g}, but F is {expected[at]:.4g}: "
        words += f"Φ(s) = {phi[at]:.4g}, Φ(s') = {successor[at]:.4g}"
        fitting = (name for name, values in mistakes if np.all(np.abs(evidence.added - values)[wrong] <= tolerance))
        name = next(fitting, None)
        hit = next((clipping.words for clipping in bounds if np.all(clipping.where[wrong])), "")
        if name is None and hit:
            name, words = "clipped", f"{words}; {hit}"
        name = name or otherwise
        if name not in {finding.name for finding in findings}:
            findings.append(Finding(name, int(evidence.step[at]), f"{words}."))
    return findings


def _groups(evidence: Evidence, fit: Fit, tolerance: float) -> list[_Group]:
    phi, successor, shown, before = (
        fit.scale * leaf + fit.bias for leaf in (evidence.phi, evidence.successor, evidence.shown, evidence.last_before)
    )
    right, zero = shaping_reward(phi, fit.gamma, successor), np.zeros_like(phi)
    began = ~evidence.dummy & evidence.first & ~evidence.terminated & ~evidence.truncated
    # A first step that ends at once is judged as an end only where first steps are right.
    over = ~evidence.dummy & ~(evidence.first & np.any(began & (np.abs(evidence.added - right) > tolerance)))
    mistakes_at_end = [("reset_observation_used", shaping_reward(phi, fit.gamma, shown)), ("end_not_paid", zero)]
    # A constant added to every F looks like a bias on ordinary steps, but it is paid at ends and resets too.
    centring = (fit.gamma - 1) * fit.bias
    kept = [
        ("nonzero_terminal_potential", right),
        *mistakes_at_end,
        ("normalised", centring - fit.scale * evidence.phi),
    ]
    unarmed = (shaping_reward(before, fit.gamma, successor), shaping_reward(zero, fit.gamma, successor), zero)
    not_rearmed = [("not_rearmed_at_reset", values) for values in unarmed]
    return [
        _Group("the episode terminated", over & evidence.terminated & ~evidence.truncated, -phi, kept),
        _Group(
            "it terminated and was also truncated",
            over & evidence.terminated & evidence.truncated,
            -phi,
            kept,
        ),
        _Group(
            "the episode was truncated",
            over & evidence.truncated & ~evidence.terminated,
            right,
            [("zeroed_at_truncation", -phi), *mistakes_at_end],
        ),
        _Group(
            "the environment was reset",
            evidence.dummy,
            zero,
            [("normalised", zero + centring)],
            otherwise="reset_observation_used",
        ),
        _Group("the episode began", began, right, not_rearmed),
    ]
