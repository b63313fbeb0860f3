"""`check_shaping`: is what an environment pays for shaping potential-based? Judges any wrapper, not only ours."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator
from upslope.wrappers.judging import Evidence, Finding, judge
from upslope.wrappers.recording import Recording, Seen, record


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
        """Whether nothing was found that breaks policy invariance."""
        return not any(finding.is_error for finding in self.findings)

    def __str__(self) -> str:
        seen = ", ".join(f"{count} {kind}" for kind, count in self.seen.items())
        head = (
            f"Judged {self.layer or 'no shaping wrapper'} on {seen}. Level of Φ {self.level:.4g}, drip {self.drip:.4g}."
        )
        lines = [str(finding) for finding in self.findings] or ["Potential-based: nothing was found."]
        return "\n".join([head, *lines])


def check_shaping(env: Any, potential: Any, gamma: float, *, steps: int = 2000, seed: int = 0) -> ShapingReport:
    """Plays random actions, forces ends of every kind, and compares what is added to the reward with F.

    The innermost environment is made to end some episodes early (but not in worker processes), and every layer of
    wrappers is watched from outside while the check runs; the environment is as before when it is over, but not reset.

    Args:
        env: a wrapped environment, single or vector.
        potential: Φ, as the wrapper is meant to use it: a prior, the path of a saved one, or a function of an
            observation. A wrapper may scale it and shift it.
        gamma: the learner's γ.
        steps: how many steps are played.
        seed: of everything random.

    Raises:
        UpslopeError: no environment, no potential, no discount, or an environment that fails by itself.
    """
    if not 0 < gamma <= 1:
        raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give the one that the learner uses.")
    if steps < 1:
        raise UpslopeError(f"steps is {steps}: give at least one; 2000 is a good number.")
    recording = record(env, steps, seed)
    shown = [recording.transitions(index) for index in range(len(recording.layers))]
    changing = [index for index, seen in enumerate(shown) if any(abs(one.reward - one.below) > 1e-9 for one in seen)]
    if recording.layers[0].given is None:
        changing = [index for index in changing if index > 0]
    verdicts = [_verdict(recording, index, shown[index], potential, gamma) for index in changing or [len(shown) - 1]]
    chosen = max(verdicts, key=lambda verdict: verdict.merit)
    more = [finding for verdict in verdicts if verdict.index > chosen.index for finding in _changed_again(verdict)]
    return _report(chosen, recording, chosen.findings + more, gamma, bool(changing))


@dataclass
class _Verdict:
    """One layer, judged."""

    index: int
    evidence: Evidence | None
    findings: list[Finding]

    @property
    def merit(self) -> tuple[bool, float, int]:
        """How likely this is the layer that shapes: no mistake; else the more its changes go together with F."""
        if self.evidence is None or not len(self.evidence.phi):
            return (False, 1.0, self.index)
        added, phi, successor = self.evidence.added, self.evidence.phi, self.evidence.successor
        expected = np.where(self.evidence.terminated, 0.0, successor) - phi
        together = np.std(added) > 0 and np.std(expected) > 0
        likeness = float(np.corrcoef(added, expected)[0, 1]) if together else 0.0
        return (not self.findings, likeness, self.index)


def _verdict(recording: Recording, index: int, seen: list[Seen], potential: Any, gamma: float) -> _Verdict:
    layer = recording.layers[index].env
    space = layer.single_observation_space if isinstance(layer, gym.vector.VectorEnv) else layer.observation_space
    evaluator = Evaluator(potential, space)
    hidden = [one.step for one in seen if one.successor is None]
    if hidden:
        words = f"{recording.layers[index].name} resets in the same step, but there is no infos['final_obs']."
        return _Verdict(index, None, [Finding("hidden_final_observation", hidden[0], words)])
    try:
        evidence = _evidence(seen, evaluator)
        for obs in recording.last_observations if recording.trouble is not None else []:
            _phi(evaluator, obs, len(seen))
    except _BadPotentialError as error:
        return _Verdict(index, None, [Finding("bad_potential", error.step, str(error))])
    if recording.trouble is not None:
        raise UpslopeError(
            f"The environment failed while it was checked ({type(recording.trouble).__name__}: {recording.trouble}): "
            "mend that first."
        ) from recording.trouble
    return _Verdict(index, evidence, judge(evidence, gamma))


class _BadPotentialError(UpslopeError):
    def __init__(self, step: int, error: UpslopeError):
        super().__init__(str(error))
        self.step = step


def _phi(evaluator: Evaluator, obs: Any, step: int) -> float:
    try:
        return evaluator.one(obs)
    except UpslopeError as error:
        raise _BadPotentialError(step, error) from error


def _phi_or_nan(evaluator: Evaluator, obs: Any) -> float:
    try:
        return evaluator.one(obs)
    except UpslopeError:
        return float("nan")


def _evidence(seen: list[Seen], evaluator: Evaluator) -> Evidence:
    rows = []
    for one in seen:
        # Φ need not be defined at terminal states, where it counts as zero.
        successor = (
            _phi_or_nan(evaluator, one.successor) if one.terminated else _phi(evaluator, one.successor, one.step)
        )
        shown = successor if one.shown is one.successor else _phi(evaluator, one.shown, one.step)
        before = np.nan if one.last_before is None else _phi_or_nan(evaluator, one.last_before)
        rows.append((one.reward - one.below, one.below, _phi(evaluator, one.obs, one.step), successor, shown, before))
    numbers = np.array(rows, np.float64).reshape(len(seen), 6).T
    flags = np.array(
        [(one.terminated, one.truncated, one.dummy, one.first) for one in seen], bool
    ).reshape(len(seen), 4).T  # fmt: skip
    steps: Any = np.array([one.step for one in seen], int)
    return Evidence(*numbers, *flags, steps)  # type: ignore[call-arg]


def _changed_again(verdict: _Verdict) -> list[Finding]:
    """Above the shaping rewards may be multiplied by a positive number, fixed or running, and nothing else."""
    evidence = verdict.evidence
    if evidence is None:
        return verdict.findings
    below, above = evidence.below, evidence.below + evidence.added
    if np.all((np.sign(below) == np.sign(above)) | (np.abs(below) < 1e-9)) and not _saturates(below, above):
        return []
    at = int(np.argmax(np.abs(evidence.added)))
    name = "clipped" if _saturates(below, above) else "normalised"
    words = f"above the shaping, R + F = {below[at]:.4g} was turned into {above[at]:.4g}."
    return [Finding(name, int(evidence.step[at]), words)]


def _saturates(below: np.ndarray, above: np.ndarray) -> bool:
    """Whether different rewards become one and the same bound, more than once."""
    for bound in (above.max(), above.min()):
        there = np.abs(above - bound) < 1e-9
        if np.sum(there) > 1 and np.ptp(below[there]) > 1e-6:
            return True
    return False


def _report(
    verdict: _Verdict, recording: Recording, findings: list[Finding], gamma: float, is_shaped: bool
) -> ShapingReport:
    name = recording.layers[verdict.index].name if is_shaped else ""
    evidence = verdict.evidence
    if evidence is None:
        return ShapingReport(tuple(findings), name, {}, 0.0, 0.0)
    over = ~evidence.dummy
    seen = {
        "ordinary": over & ~evidence.terminated & ~evidence.truncated,
        "terminated": over & evidence.terminated & ~evidence.truncated,
        "truncated": over & evidence.truncated & ~evidence.terminated,
        "both": over & evidence.terminated & evidence.truncated,
    }
    counts = {kind: int(np.sum(where)) for kind, where in seen.items()}
    level, spread = float(np.mean(evidence.phi)), float(np.std(evidence.phi))
    drip = (gamma - 1) * level
    if abs(level) > 10 * spread and abs(drip) > 1e-6:
        words = f"Φ is {level:.4g} on average and varies by {spread:.4g} only: each ordinary step drips {drip:.4g}"
        words += f", and a termination pays {-level:.4g}."
        findings = [*findings, Finding("large_constant_level", int(evidence.step[0]), words)]
    return ShapingReport(tuple(findings), name, counts, level, drip)
