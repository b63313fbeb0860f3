"""The mistakes that `check_shaping` knows by name, each with its fix."""

from typing import NamedTuple

#: Each mistake by name, and how to fix it.
FIXES = {
    "never_applied": "Check that the learner steps the shaped environment, and that shaping is enabled. "
    "Shaping inside the environment itself is visible only if info['raw_reward'] reports the raw reward.",
    "nonzero_terminal_potential": "Count Φ(s') as zero where an episode terminated, even if it was also truncated.",
    "zeroed_at_truncation": "Keep γΦ(s') where an episode was truncated: the learner bootstraps there.",
    "reset_observation_used": "Use the true last observation as s', not the one after the reset; pay no F for a reset.",
    "not_rearmed_at_reset": "Set the remembered Φ(s) to that of the first observation whenever an episode begins.",
    "end_not_paid": "Pay F at the last step of an episode too: −Φ(s) where it terminated.",
    "gamma_mismatch": "Give the shaping the learner's γ.",
    "clipped": "Never clip F or R + F; lower the scale of Φ instead.",
    "normalised": "Never centre F or R + F, nor normalise F; put reward normalisation outside the shaping.",
    "stale_mixture": "Use one version of Φ all the time, or shape where batches are drawn from the replay.",
    "not_potential_based": "Pay F = γ·(1 − terminated)·Φ(s') − Φ(s), with the Φ given to this check.",
    "bad_potential": "Make Φ return one finite number for every observation.",
    "wrong_observation_shape": "Correct the observation_space, or the wrapper that changes the observation's shape.",
    "hidden_final_observation": "Report the last observation of an episode that resets in the same step.",
    "not_judged": "Take more steps; or check one environment, alone or in a SyncVectorEnv, where all ends are forced.",
    "large_constant_level": "Subtract the mean from Φ (bias), unless you want its effect on Q's initial values.",
}


class Finding(NamedTuple):
    """One mistake.

    Attributes:
        name: a key of `FIXES`.
        step: the first at which it shows.
        evidence: the values that show it.
    """

    name: str
    step: int
    evidence: str

    @property
    def fix(self) -> str:
        """How to fix it."""
        return FIXES[self.name]

    @property
    def is_error(self) -> bool:
        """Whether it breaks policy invariance or leaves that open; if not, it is just worth knowing."""
        return self.name != "large_constant_level"

    def __str__(self) -> str:
        return f"{self.name} (step {self.step}): {self.evidence} {self.fix}"
