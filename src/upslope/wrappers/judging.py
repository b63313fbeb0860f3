"""Tells from recorded transitions whether what a layer added to the reward is potential-based, and if not, why not."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

#: Name of each mistake, and its mend.
MENDS = {
    "never_applied": "Check that the shaped environment is the one that the learner steps, and that shaping is on.",
    "nonzero_terminal_potential": "Count Φ(s') as zero where an episode terminated, also where it was truncated too.",
    "zeroed_at_truncation": "Keep γΦ(s') where an episode was truncated: the learner bootstraps there.",
    "reset_observation_used": "Use the true last observation as s', not the one after the reset; a reset pays no F.",
    "not_rearmed_at_reset": "Set the remembered Φ(s) to that of the reset observation whenever an episode begins.",
    "end_not_paid": "Pay F at the last step of an episode too: −Φ(s) where it terminated.",
    "gamma_mismatch": "Give the shaping the learner's γ.",
    "clipped": "Never clip F or R + F; lower the scale of Φ instead.",
    "normalised": "Never normalise or centre F or R + F; put reward normalisation outside the shaping.",
    "stale_mixture": "Use one version of Φ throughout, or shape where a batch is drawn from the replay.",
    "not_potential_based": "Pay F = γ·(1 − terminated)·Φ(s') − Φ(s), with the Φ that is checked here.",
    "bad_potential": "Make Φ return one finite number for every observation.",
    "hidden_final_observation": "Give the last observation of an episode that resets in the same step.",
    "large_constant_level": "Subtract the level from Φ (bias), unless its effect on Q's initial value is wanted.",
}


class Finding(NamedTuple):
    """One mistake.

    Attributes:
        name: a key of `MENDS`.
        step: where it showed first, counted over the run.
        evidence: the values that show it.
    """

    name: str
    step: int
    evidence: str

    @property
    def mend(self) -> str:
        return MENDS[self.name]

    @property
    def is_error(self) -> bool:
        """Whether it breaks policy invariance; the others are worth knowing."""
        return self.name != "large_constant_level"

    def __str__(self) -> str:
        return f"{self.name} (step {self.step}): {self.evidence} {self.mend}"


class Evidence(NamedTuple):
    """Transitions ``[n]`` of one layer, as numbers.

    Attributes:
        added: what the layer added to the reward.
        below: the reward that it was given.
        phi: Φ(s).
        successor: Φ(s') at the true successor.
        shown: Φ of the observation that was returned, which may be a reset observation.
        last_before: Φ of the last observation of the episode before; NaN for none.
        terminated: and so on, see `upslope.wrappers.recording.Seen`.
    """

    added: Float[np.ndarray, "n"]
    below: Float[np.ndarray, "n"]
    phi: Float[np.ndarray, "n"]
    successor: Float[np.ndarray, "n"]
    shown: Float[np.ndarray, "n"]
    last_before: Float[np.ndarray, "n"]
    terminated: Bool[np.ndarray, "n"]
    truncated: Bool[np.ndarray, "n"]
    dummy: Bool[np.ndarray, "n"]
    first: Bool[np.ndarray, "n"]
    step: Any

    def take(self, where: Any) -> "Evidence":
        return Evidence(*(leaf[where] for leaf in self))


class Fit(NamedTuple):
    """The γ and the potential c·Φ + b that ordinary steps were shaped with."""

    gamma: float
    scale: float = 1.0
    bias: float = 0.0


def judge(evidence: Evidence, gamma: float) -> list[Finding]:
    """Every mistake that the transitions show; none if they are shaped by b + c·Φ with any b and c > 0."""
    size = max(1e-9, float(np.nanmax(np.abs([evidence.phi, evidence.successor]))))
    tolerance = 1e-6 + 1e-5 * size  # wrappers may compute in single precision
    expected = gamma * np.where(evidence.terminated, 0.0, evidence.successor) - evidence.phi
    if np.all(np.abs(evidence.added) <= tolerance):
        expected = np.where(evidence.dummy, 0.0, expected)
        at = int(np.argmax(np.abs(expected)))
        if abs(expected[at]) <= 10 * tolerance:
            return []
        words = f"no reward was changed, but F should be {expected[at]:.4g} here."
        return [Finding("never_applied", int(evidence.step[at]), words)]
    ordinary = evidence.take(~(evidence.terminated | evidence.truncated | evidence.dummy | evidence.first))
    fit = fit_ordinary(ordinary, gamma, tolerance)
    if fit is None:
        return [explain_misfit(ordinary, gamma, tolerance)]
    findings = []
    if abs(fit.gamma - gamma) > 1e-4:
        at = int(np.argmax(np.abs(ordinary.successor)))
        words = (
            f"F is {ordinary.added[at]:.4g} for Φ(s) = {ordinary.phi[at]:.4g} and Φ(s') = {ordinary.successor[at]:.4g}"
        )
        words += f", which is γ = {fit.gamma:.4g} and not {gamma:.4g}."
        findings.append(Finding("gamma_mismatch", int(ordinary.step[at]), words))
    return findings + judge_ends(evidence, fit, tolerance * max(1.0, fit.scale))


def fit_ordinary(ordinary: Evidence, gamma: float, tolerance: float) -> Fit | None:
    """The γ, scale and bias that explain every ordinary step, the simplest that do; None if nothing does."""
    phi, successor, added = ordinary.phi, ordinary.successor, ordinary.added
    if not len(phi):
        return Fit(gamma)

    def explains(fit: Fit) -> bool:
        psi, following = fit.scale * phi + fit.bias, fit.scale * successor + fit.bias
        slack = tolerance * max(1.0, fit.scale) + 1e-5 * abs(fit.bias)
        return fit.scale > 0 and bool(np.all(np.abs(fit.gamma * following - psi - added) <= slack))

    plain = gamma * successor - phi
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
        if minus_scale < 0 and abs(ahead + minus_scale) > 1e-9:
            other = float(-ahead / minus_scale)
            candidates.append(Fit(other, float(-minus_scale), float(drip) / (other - 1)))
    return next((fit for fit in candidates if explains(fit)), None)


def explain_misfit(ordinary: Evidence, gamma: float, tolerance: float) -> Finding:
    """Why ordinary steps are not shaped by Φ with any γ, scale and bias."""
    phi, successor, added = ordinary.phi, ordinary.successor, ordinary.added
    expected = gamma * successor - phi
    wrong = np.abs(added - expected) > tolerance
    at = int(np.argmax(wrong))
    step, words = int(ordinary.step[at]), f"the reward was changed by {added[at]:.4g}, but F is {expected[at]:.4g} here"
    for what, got, right in (("F", added, expected), ("R + F", added + ordinary.below, expected + ordinary.below)):
        top = wrong & (np.abs(got - got.max()) <= tolerance) & (right > got)
        bottom = wrong & (np.abs(got - got.min()) <= tolerance) & (right < got)
        if np.all(wrong == (top | bottom)) and np.sum(wrong) >= 2 and not np.all(wrong):
            return Finding("clipped", step, f"{words}; {what} never leaves {got.min():.4g} to {got.max():.4g}.")
    if _drifts(ordinary, gamma, tolerance) or 0.05 <= np.mean(wrong) <= 0.95:
        share = f"{np.mean(~wrong):.0%} of the steps fit Φ" if np.any(~wrong) else "the weight of Φ changes over time"
        return Finding("stale_mixture", step, f"{words}, although {share}: more than one version of Φ is at work.")
    if np.std(added) > 0 and np.std(expected) > 0 and np.corrcoef(added, expected)[0, 1] > 0.7:
        return Finding("normalised", step, f"{words}; the two go together, but no γ, scale and bias make them equal.")
    return Finding("not_potential_based", step, f"{words}, and no γ, scale and bias of Φ make them equal.")


def _drifts(ordinary: Evidence, gamma: float, tolerance: float, window: int = 40) -> bool:
    """Whether a weight of Φ that changes over time explains most stretches of the run."""
    explained = []
    for start in range(0, len(ordinary.phi) - window + 1, window):
        part = ordinary.take(slice(start, start + window))
        time = (part.step - np.mean(part.step)) / np.ptp(part.step)
        columns = np.stack([part.successor, part.phi, time * part.successor, time * part.phi], axis=1)
        weights = np.linalg.lstsq(columns, part.added, rcond=None)[0]
        fits = np.all(np.abs(columns @ weights - part.added) <= 10 * tolerance)
        is_difference = weights[1] <= 0 and abs(weights[0] + gamma * weights[1]) <= 0.02 * abs(weights[0]) + tolerance
        explained.append(fits and is_difference)
    return bool(explained) and bool(np.mean(explained) > 0.7)


def judge_ends(evidence: Evidence, fit: Fit, tolerance: float) -> list[Finding]:
    """Mistakes at terminations, truncations, resets and first steps, with the γ and the level of ordinary steps."""
    phi, successor, shown = (fit.scale * leaf + fit.bias for leaf in (evidence.phi, evidence.successor, evidence.shown))
    before = fit.scale * evidence.last_before + fit.bias
    ahead, zero = fit.gamma * successor, np.zeros_like(phi)
    began = ~evidence.dummy & evidence.first & ~evidence.terminated & ~evidence.truncated
    # A first step that ends at once is judged as an end only where first steps are right.
    over = ~evidence.dummy & ~(evidence.first & np.any(began & (np.abs(evidence.added - ahead + phi) > tolerance)))
    unpaid = ("end_not_paid", zero)
    mistakes_at_end = [("reset_observation_used", fit.gamma * shown - phi), unpaid]
    centred = ("normalised", -fit.scale * evidence.phi + (fit.gamma - 1) * fit.bias)
    kept = [("nonzero_terminal_potential", ahead - phi), *mistakes_at_end, centred]
    groups = [
        ("the episode terminated", over & evidence.terminated & ~evidence.truncated, -phi, kept),
        ("it terminated and was truncated at once", over & evidence.terminated & evidence.truncated, -phi, kept),
        (
            "the episode was truncated",
            over & evidence.truncated & ~evidence.terminated,
            ahead - phi,
            [("zeroed_at_truncation", -phi), *mistakes_at_end],
        ),
        ("the environment was reset", evidence.dummy, zero, [("reset_observation_used", evidence.added)]),
        (
            "the episode began",
            began,
            ahead - phi,
            [("not_rearmed_at_reset", ahead - before), ("not_rearmed_at_reset", ahead), ("not_rearmed_at_reset", zero)],
        ),
    ]
    findings: list[Finding] = []
    for where, group, expected, mistakes in groups:
        wrong = np.flatnonzero(group & (np.abs(evidence.added - expected) > tolerance))
        if not wrong.size:
            continue
        fitting = (name for name, values in mistakes if np.all(np.abs(evidence.added - values)[wrong] <= tolerance))
        name = next(fitting, "not_potential_based")
        at = wrong[0]
        words = f"where {where}, the reward was changed by {evidence.added[at]:.4g}, but F is {expected[at]:.4g}: "
        words += f"Φ(s) = {phi[at]:.4g}, Φ(s') = {successor[at]:.4g}."
        if name not in {finding.name for finding in findings}:
            findings.append(Finding(name, int(evidence.step[at]), words))
    return findings
