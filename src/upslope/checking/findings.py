"""The mistakes that `check_shaping` knows by name, each with its mend."""

from typing import NamedTuple

#: Name of each mistake, and its mend.
MENDS = {
    "never_applied": "Check that the shaped environment is the one that the learner steps, and that shaping is on. "
    "Shaping inside the environment itself is seen only where info['raw_reward'] tells the raw reward.",
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
    "wrong_observation_shape": "Mend the environment's observation_space, or what changes the observation's shape.",
    "hidden_final_observation": "Give the last observation of an episode that resets in the same step.",
    "not_judged": "Play more steps; or check one environment, alone or in a SyncVectorEnv, where all ends are forced.",
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
        """Whether it breaks policy invariance, or leaves that open; the others are worth knowing."""
        return self.name != "large_constant_level"

    def __str__(self) -> str:
        return f"{self.name} (step {self.step}): {self.evidence} {self.mend}"
