"""What `check_shaping` reports: the findings, and what they rest on."""

from dataclasses import dataclass

import numpy as np

from upslope.checking.evidence import Evidence
from upslope.checking.findings import Finding


@dataclass(frozen=True)
class ShapingReport:
    """What `check_shaping` found.

    Attributes:
        findings: the mistakes, each with its evidence and its mend.
        layer: the wrapper that shapes; empty if none does.
        seen: how many transitions of each kind were judged.
        level: mean of Φ over the observations.
        drip: (γ − 1)·level, what every ordinary step is paid for the level alone.
    """

    findings: tuple[Finding, ...]
    layer: str
    seen: dict[str, int]
    level: float
    drip: float

    @property
    def ok(self) -> bool:
        """Whether steps of every kind were judged, and nothing was found that breaks policy invariance."""
        return not any(finding.is_error for finding in self.findings)

    def __str__(self) -> str:
        seen = ", ".join(f"{count} {kind}" for kind, count in self.seen.items()) or "nothing"
        head = (
            f"Judged {self.layer or 'no shaping wrapper'} on {seen}. Level of Φ {self.level:.4g}, drip {self.drip:.4g}."
        )
        lines = [str(finding) for finding in self.findings] or ["Potential-based: nothing was found."]
        return "\n".join([head, *lines])


def reported(findings: list[Finding], layer: str, evidence: Evidence | None, gamma: float) -> ShapingReport:
    """The report on one layer's evidence, with what its numbers say beside the mistakes."""
    if evidence is None:
        return ShapingReport(tuple(findings), layer, {}, 0.0, 0.0)
    seen = _seen(evidence)
    if not findings and not all(seen.values()):
        # What was not seen matters where nothing else is wrong.
        findings = [_not_judged(seen, evidence)]
    level, spread = float(np.mean(evidence.phi)), float(np.std(evidence.phi))
    drip = (gamma - 1) * level
    if abs(level) > 10 * spread and abs(drip) > 1e-6:
        words = f"Φ is {level:.4g} on average and varies by {spread:.4g} only: each ordinary step drips {drip:.4g}"
        words += f", and a termination pays {-level:.4g}."
        findings = [*findings, Finding("large_constant_level", int(evidence.step[0]), words)]
    return ShapingReport(tuple(findings), layer, seen, level, drip)


def _seen(evidence: Evidence) -> dict[str, int]:
    kinds = {
        "ordinary": ~evidence.terminated & ~evidence.truncated,
        "terminated": evidence.terminated & ~evidence.truncated,
        "truncated": evidence.truncated & ~evidence.terminated,
        "both": evidence.terminated & evidence.truncated,
    }
    return {kind: int(np.sum(where & ~evidence.dummy)) for kind, where in kinds.items()}


def _not_judged(seen: dict[str, int], evidence: Evidence) -> Finding:
    missing = ", ".join(kind for kind, count in seen.items() if not count)
    words = f"nothing wrong was seen, but there were no steps of these kinds: {missing}."
    return Finding("not_judged", int(evidence.step[-1]), words)
