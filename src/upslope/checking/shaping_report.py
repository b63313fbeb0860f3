"""The report of `check_shaping`: the findings and the evidence behind them."""

from dataclasses import dataclass

import numpy as np

from upslope.checking.evidence import Evidence
from upslope.checking.findings import Finding


@dataclass(frozen=True)
class ShapingReport:
    """What `check_shaping` found.

    Attributes:
        findings: the mistakes, each with its evidence and its fix.
        layer: the wrapper that shapes; empty if none does.
        counts: number of judged transitions of each kind.
        level: mean of Φ over the observations.
        drip: (γ − 1)·level, what every ordinary step is paid for the level alone.
    """

    findings: tuple[Finding, ...]
    layer: str
    counts: dict[str, int]
    level: float
    drip: float

    @property
    def ok(self) -> bool:
        """Whether steps of every kind were judged and nothing breaks policy invariance."""
        return not any(finding.is_error for finding in self.findings)

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {kind}" for kind, count in self.counts.items())
        head = (
            f"Checked {self.layer or 'an environment that does not shape'} on {sum(self.counts.values())} transitions "
            f"({counts or 'none'}). The mean of Φ is {self.level:.4g}; for it alone a step pays {self.drip:.4g}."
        )
        lines = [str(finding) for finding in self.findings] or [
            "The shaping is potential-based: no mistakes were found."
        ]
        return "\n".join([head, *lines])


def report_on(findings: list[Finding], layer: str, evidence: Evidence | None, gamma: float) -> ShapingReport:
    """The report on one layer, with the remarks that follow from its numbers."""
    if evidence is None:
        return ShapingReport(tuple(findings), layer, {}, 0.0, 0.0)
    counts = _counts(evidence)
    if not findings and not all(counts.values()):
        # A missing kind of transition matters only if nothing else is wrong.
        findings = [_not_judged(counts, evidence)]
    level, spread = float(np.mean(evidence.phi)), float(np.std(evidence.phi))
    drip = (gamma - 1) * level
    if abs(level) > 10 * spread and abs(drip) > 1e-6:
        words = f"Φ is {level:.4g} on average and varies by only {spread:.4g}: for the mean alone an ordinary step"
        words += f" pays {drip:.4g}, and a termination {-level:.4g}."
        findings = [*findings, Finding("large_constant_level", int(evidence.step[0]), words)]
    return ShapingReport(tuple(findings), layer, counts, level, drip)


def _counts(evidence: Evidence) -> dict[str, int]:
    kinds = {
        "ordinary": ~evidence.terminated & ~evidence.truncated,
        "terminated": evidence.terminated & ~evidence.truncated,
        "truncated": evidence.truncated & ~evidence.terminated,
        "both": evidence.terminated & evidence.truncated,
    }
    return {kind: int(np.sum(where & ~evidence.dummy)) for kind, where in kinds.items()}


def _not_judged(counts: dict[str, int], evidence: Evidence) -> Finding:
    missing = ", ".join(kind for kind, count in counts.items() if not count)
    words = f"no mistake was found, but there were no steps of these kinds: {missing}."
    return Finding("not_judged", int(evidence.step[-1]), words)
