"""`check_shaping`: is what an environment pays for shaping potential-based? Judges any wrapper, not only ours."""

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import gymnasium as gym
import numpy as np

from upslope.checking.evidence import Evidence, UnusableError, gather, phi_of
from upslope.checking.findings import Finding
from upslope.checking.judging import judge
from upslope.checking.recording import Recording, Seen, record
from upslope.checking.shaping_report import ShapingReport, reported
from upslope.errors import UpslopeError
from upslope.wrappers.evaluation import Evaluator


def check_shaping(
    env: Any, potential: Any, gamma: float | Any, *, steps: int | Any = 2000, seed: int | Any = 0
) -> ShapingReport:
    """Plays random actions, forces ends of every kind, and compares what is added to the reward with F.

    The innermost environment is made to end some episodes early (but not in worker processes), and every layer of
    wrappers is watched from outside while the check runs; the environment is as before when it is over, but not reset.
    Shaping below the layers that can be watched is judged where ``info["raw_reward"]`` tells the raw rewards.

    Args:
        env: a wrapped environment, single or vector.
        potential: Φ, as the wrapper is meant to use it: a prior, the path of a saved one, or a function of an
            observation. A wrapper may scale it and shift it.
        gamma: the learner's γ.
        steps: how many steps are played.
        seed: of everything random.

    Raises:
        UpslopeError: no environment, no potential, no discount, an environment that fails by itself, or workers that
            may shape but hide their raw rewards.
    """
    _check_settings(gamma, steps, seed)
    gamma, steps, seed = float(gamma), int(steps), int(seed)
    recording = record(env, steps, seed)
    shown = [recording.transitions(index) for index in range(len(recording.layers))]
    changing = [index for index, seen in enumerate(shown) if any(abs(one.reward - one.below) > 1e-9 for one in seen)]
    is_hidden = any(np.isnan(one.below) for one in shown[0])
    if is_hidden and recording.trouble is None and (not changing or changing[0] == 0):
        raise UpslopeError(
            "No wrapper outside the worker processes changes a reward, and the workers hide their raw rewards: check "
            "one environment alone, or the same ones in a SyncVectorEnv."
        )
    innermost = recording.layers[0]
    if recording.trouble is not None and innermost.misshapen is not None:
        return reported([Finding("wrong_observation_shape", *innermost.misshapen)], innermost.name, None, gamma)
    verdicts = [_verdict(recording, index, shown[index], potential, gamma) for index in changing or [len(shown) - 1]]
    chosen = max(verdicts, key=lambda verdict: verdict.merit)
    more = [finding for verdict in verdicts if verdict.index > chosen.index for finding in _changed_again(verdict)]
    layer = recording.layers[chosen.index].name if changing else ""
    return reported(chosen.findings + more, layer, chosen.evidence, gamma)


def _check_settings(gamma: Any, steps: Any, seed: Any) -> None:
    if not (isinstance(gamma, Real) and not isinstance(gamma, bool) and 0 < float(gamma) <= 1):
        raise UpslopeError(f"gamma is {gamma!r}, but a discount lies in (0, 1]: give the one that the learner uses.")
    if not (isinstance(steps, Integral) and int(steps) >= 1):
        raise UpslopeError(f"steps is {steps!r}: give a whole number of at least one; 2000 is a good number.")
    if not (isinstance(seed, Integral) and int(seed) >= 0):
        raise UpslopeError(f"seed is {seed!r}: give a whole number from zero on.")


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
        added, expected = self.evidence.added, self.evidence.expected(1.0)
        together = np.std(added) > 0 and np.std(expected) > 0
        likeness = float(np.corrcoef(added, expected)[0, 1]) if together else 0.0
        return (not self.findings, likeness, self.index)


def _verdict(recording: Recording, index: int, seen: list[Seen], potential: Any, gamma: float) -> _Verdict:
    space = _space(recording, index)
    evaluator = Evaluator(potential, space)
    hidden = [one.step for one in seen if one.successor is None]
    if hidden:
        words = f"{recording.layers[index].name} resets in the same step, but there is no infos['final_obs']."
        return _Verdict(index, None, [Finding("hidden_final_observation", hidden[0], words)])
    try:
        evidence = gather(seen, evaluator, space)
        if recording.trouble is not None:  # a wrapper may have failed on what it was given last
            below = max(0, index - 1)
            for obs in recording.last_observations(below):
                phi_of(evaluator, _space(recording, below), obs, len(seen))
    except UnusableError as error:
        return _Verdict(index, None, [Finding(error.name, error.step, str(error))])
    if recording.trouble is not None:
        raise UpslopeError(
            f"The environment failed while it was checked ({type(recording.trouble).__name__}: {recording.trouble}): "
            "mend that first."
        ) from recording.trouble
    return _Verdict(index, evidence, judge(evidence, gamma))


def _space(recording: Recording, index: int) -> gym.Space:
    """Of one observation."""
    layer = recording.layers[index].env
    return layer.single_observation_space if isinstance(layer, gym.vector.VectorEnv) else layer.observation_space


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
