"""`check_shaping`: checks that the shaping of an environment is potential-based, whoever wrote its wrapper."""

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from upslope.checking.calls import LayerTransition
from upslope.checking.evidence import Evidence, UnusableError, gather, phi_of
from upslope.checking.findings import Finding
from upslope.checking.judging import judge
from upslope.checking.recording import Recording, record
from upslope.checking.shaping_report import ShapingReport, report_on
from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator


def check_shaping(
    env: Any, potential: Any, gamma: float | Any, *, steps: int | Any = 2000, seed: int | Any = 0
) -> ShapingReport:
    """Takes random actions, makes episodes end in every way, and compares what is added to the reward with F.

    Some episodes of the innermost environment are made to end early (but not in worker processes), and all layers of
    wrappers are watched from outside during the check. Afterwards the environment is as before, but not reset. Shaping
    inside the innermost environment is checked only if ``info["raw_reward"]`` reports the raw rewards.

    Args:
        env: a wrapped Gymnasium environment, single or vector.
        potential: Φ that the wrapper should use: a prior, the path of a saved one, or a function of an observation.
            A wrapper may scale it and add a constant.
        gamma: the learner's γ.
        steps: number of steps to take.
        seed: of everything random.

    Raises:
        UpslopeError: the environment, the potential or the discount is not one; the environment itself fails; or its
            workers hide their raw rewards although the shaping may be inside them.
    """
    _check_settings(gamma, steps, seed)
    gamma, steps, seed = float(gamma), int(steps), int(seed)
    recording = record(env, steps, seed)
    shown = [layer.transitions for layer in recording.layers]
    changing = [index for index, seen in enumerate(shown) if any(abs(one.reward - one.below) > 1e-9 for one in seen)]
    is_hidden = any(np.isnan(one.below) for one in shown[0])
    if is_hidden and recording.trouble is None and (not changing or changing[0] == 0):
        raise UpslopeError(
            "No wrapper outside the worker processes changes a reward, and the workers hide their raw rewards: check "
            "one environment alone, or the same ones in a SyncVectorEnv."
        )
    misfit = recording.innermost.misfit
    if recording.trouble is not None and misfit is not None:
        return report_on([Finding("wrong_observation_shape", *misfit)], recording.layers[0].name, None, gamma)
    verdicts = [_verdict(recording, index, shown[index], potential, gamma) for index in changing or [len(shown) - 1]]
    chosen = max(verdicts, key=lambda verdict: verdict.merit)
    more = [finding for verdict in verdicts if verdict.index > chosen.index for finding in _changed_again(verdict)]
    layer = recording.layers[chosen.index].name if changing else ""
    return report_on(chosen.findings + more, layer, chosen.evidence, gamma)


def _check_settings(gamma: Any, steps: Any, seed: Any) -> None:
    if not (isinstance(gamma, Real) and not isinstance(gamma, bool) and 0 < float(gamma) <= 1):
        raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give the learner's.")
    if not (isinstance(steps, Integral) and int(steps) >= 1):
        raise UpslopeError(f"steps is {steps!r}: give a whole number of at least 1, such as 2000.")
    if not (isinstance(seed, Integral) and int(seed) >= 0):
        raise UpslopeError(f"seed is {seed!r}: give a whole number of at least 0.")


@dataclass
class _Verdict:
    """What was found in one layer."""

    index: int
    evidence: Evidence | None
    findings: list[Finding]

    @property
    def merit(self) -> tuple[bool, float, int]:
        """How likely this layer shapes: first one without mistakes, then by the correlation of its changes with F."""
        if self.evidence is None or not len(self.evidence.phi):
            return (False, 1.0, self.index)
        added, expected = self.evidence.added, self.evidence.expected(1.0)
        is_defined = np.std(added) > 0 and np.std(expected) > 0
        correlation = float(np.corrcoef(added, expected)[0, 1]) if is_defined else 0.0
        return (not self.findings, correlation, self.index)


def _verdict(recording: Recording, index: int, seen: list[LayerTransition], potential: Any, gamma: float) -> _Verdict:
    layer = recording.layers[index]
    evaluator = Evaluator(potential, layer.space)
    hidden = [one.step for one in seen if one.successor is None]
    if hidden:
        words = f"{layer.name} resets in the same step, but does not report infos['final_obs']."
        return _Verdict(index, None, [Finding("hidden_final_observation", hidden[0], words)])
    try:
        evidence = gather(seen, evaluator, layer.space)
        if recording.trouble is not None:  # a wrapper may have failed on the last observation it was given
            below = recording.layers[max(0, index - 1)]
            for obs in below.last_observations:
                phi_of(evaluator, below.space, obs, len(seen))
    except UnusableError as error:
        return _Verdict(index, None, [Finding(error.name, error.step, str(error))])
    if recording.trouble is not None:
        raise UpslopeError(
            f"The environment failed while it was checked ({type(recording.trouble).__name__}: {recording.trouble}): "
            "fix that first."
        ) from recording.trouble
    return _Verdict(index, evidence, judge(evidence, gamma))


def _changed_again(verdict: _Verdict) -> list[Finding]:
    """Layers outside the shaping may multiply the rewards by a positive number, fixed or running, and no more."""
    evidence = verdict.evidence
    if evidence is None:
        return verdict.findings
    below, above = evidence.below, evidence.below + evidence.added
    if np.all((np.sign(below) == np.sign(above)) | (np.abs(below) < 1e-9)) and not _saturates(below, above):
        return []
    at = int(np.argmax(np.abs(evidence.added)))
    name = "clipped" if _saturates(below, above) else "normalised"
    words = f"outside the shaping, R + F = {below[at]:.4g} became {above[at]:.4g}."
    return [Finding(name, int(evidence.step[at]), words)]


def _saturates(below: np.ndarray, above: np.ndarray) -> bool:
    """Whether different rewards become the same bound, more than once."""
    for bound in (above.max(), above.min()):
        there = np.abs(above - bound) < 1e-9
        if np.sum(there) > 1 and np.ptp(below[there]) > 1e-6:
            return True
    return False
