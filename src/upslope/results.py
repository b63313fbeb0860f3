"""What the verbs return: something that acts and can be saved, with its learning curve."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from upslope.learners.agent import Agent
from upslope.learners.curve import LearningCurve
from upslope.priors.prior import Prior


class _OnACurve:
    """The parts of a result's learning curve."""

    curve: LearningCurve

    @property
    def updates(self) -> Int[np.ndarray, "reports"]:
        """Updates before each report: gradient updates of `train`, pairs of Eqs. 8 and 9 of `adapt`."""
        return self.curve.updates

    @property
    def returns(self) -> Float[np.ndarray, "reports"]:
        """The raw greedy return at each report, without the shaping reward."""
        return self.curve.returns

    @property
    def metrics(self) -> dict[str, np.ndarray]:
        """Means of the learner's own measurements since the report before ``[reports]``, by name."""
        return self.curve.metrics


@dataclass(frozen=True, eq=False, repr=False)
class TrainingResult(_OnACurve):
    """What `upslope.train` returns.

    Attributes:
        agent: the trained agent.
        curve: its learning curve.
    """

    agent: Agent
    curve: LearningCurve

    def __repr__(self) -> str:
        return f"TrainingResult({self.curve.summary()},\n  {self.agent!r})"


@dataclass(frozen=True, eq=False, repr=False)
class AdaptationResult(_OnACurve):
    """What `upslope.adapt` returns.

    Attributes:
        posterior: the adapted prior; it shapes, acts, and is saved like any prior.
        curve: its learning curve.
    """

    posterior: Prior
    curve: LearningCurve

    @property
    def agent(self) -> Prior:
        """The posterior, which acts by its advantage head."""
        return self.posterior

    def __repr__(self) -> str:
        return f"AdaptationResult({self.curve.summary()},\n  posterior={self.posterior!r})"
