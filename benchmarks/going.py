"""A batch of learners that can always train further: the programs of `upslope.run`, without their loop."""

from typing import Any

import jax
import numpy as np

from upslope.learners.learner import AbstractLearner
from upslope.run.engines import ENGINES, lay_out
from upslope.types import Keys


class Going:
    """Learners in the middle of their work.

    Attributes:
        count: how many, padding left out.
    """

    def __init__(self, learners: AbstractLearner, keys: Keys):
        self.count = len(keys)
        self._engine = ENGINES[learners.engine]
        self._learners, keys = lay_out(self._engine, learners, keys)
        self._states, self._totals = self._engine.start(self._learners, keys)

    def advance(self, steps: int) -> None:
        """So many steps more, waited for."""
        self._advance(steps, report=False)

    def reports(self) -> dict[str, Any]:
        """What they report now ``[count, ...]``."""
        found = self._advance(0, report=True)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: self.count], found)

    @property
    def states(self) -> Any:
        """What they hold now, padding included; the next advance takes it away."""
        return self._states

    def _advance(self, steps: int, *, report: bool) -> dict[str, Any]:
        chunk = self._engine.advance(self._learners, self._states, self._totals, steps, fresh=False, report=report)
        self._states, self._totals, report = jax.block_until_ready((chunk.states, chunk.totals, chunk.report))
        return report
