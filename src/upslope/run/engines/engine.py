"""The interface between the loop and what drives learners: compiled programs, or environments on the host."""

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from upslope.learners.learner import AbstractLearner
from upslope.run.randomness import unroll
from upslope.types import Keys, Metrics


class Chunk(NamedTuple):
    """The result of a chunk of steps, ``[learners, ...]``.

    Attributes:
        states: the learners' states.
        totals: sums of the metrics since the last report.
        broken: the first step of the chunk, counted from 1, with a metric that is not finite; 0 if there is none.
        report: the learners' reports; zeros, or nothing, if no report was requested.
    """

    states: Any
    totals: Metrics
    broken: Int[Array, "learners"]
    report: dict[str, Any]


class AbstractEngine(ABC):
    """Takes steps with a batch of learners. The loop asks nothing else.

    Batches have one axis of learners ``[learners, ...]``, as `lay_out` leaves them; 0-d leaves are shared by all.

    Attributes:
        restores_episodes: whether a resumed run continues in the middle of its episodes. If not, it starts new ones.
    """

    restores_episodes: ClassVar[bool]

    @abstractmethod
    def device_count(self, learners: int) -> int:
        """The number of devices that share this many learners. Their number is padded to a multiple of it."""

    @abstractmethod
    def spread(self, learners: AbstractLearner, batch: Any) -> Any:
        """Spreads the leading axis of a PyTree ``[learners, ...]`` over the devices; their number must divide it."""

    @abstractmethod
    def compile(self, learners: AbstractLearner, keys: Keys) -> None:
        """Compiles what `start` and `advance` need, if that can be done ahead of them."""

    @abstractmethod
    def start(self, learners: AbstractLearner, keys: Keys) -> tuple[Any, Metrics]:
        """The states ``[learners, ...]`` before the first step, and the sums of the metrics, all zero."""

    @abstractmethod
    def advance(
        self, learners: AbstractLearner, states: Any, totals: Metrics, steps: int, *, fresh: bool, report: bool
    ) -> Chunk:
        """Takes a number of steps with every learner. Consumes the given states and totals.

        A run that is cut into other chunks takes the same steps, bit for bit.

        Args:
            learners: ``[learners, ...]``.
            states: ``[learners, ...]``.
            totals: sums of the metrics so far ``[learners, ...]``.
            steps: their number; may be 0.
            fresh: set the sums to zero first.
            report: let every learner report at the end.
        """

    @abstractmethod
    def shapes(self, learners: AbstractLearner, keys: Keys) -> tuple[Any, Any, Any]:
        """The shapes of states, totals and reports ``[learners, ...]``; computes none of them."""

    @abstractmethod
    def close(self, learners: AbstractLearner) -> None:
        """Releases what the learners hold open, such as environments."""


def lay_out(engine: AbstractEngine, learners: AbstractLearner, keys: Keys) -> tuple[AbstractLearner, Keys]:
    """Learners and keys ``[*batch, ...]`` with one axis of learners, padded and spread over the engine's devices."""
    batch, count = keys.shape, math.prod(keys.shape)

    def flatten(leaf: Any) -> Any:
        # With NumPy, because JAX would compile a program for each shape.
        leaf = leaf if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else np.asarray(leaf)
        return pad(engine, leaf.reshape(count, *leaf.shape[len(batch) :]))

    learners = jax.tree.map(lambda leaf: flatten(leaf) if np.ndim(leaf) else leaf, learners)
    return engine.spread(learners, (learners, flatten(unroll(keys))))


def pad(engine: AbstractEngine, leaf: Any) -> Any:
    """Repeats the last learner of ``[learners, ...]`` until the number of devices divides that of the learners."""
    missing = -leaf.shape[0] % engine.device_count(leaf.shape[0])
    return leaf[np.minimum(np.arange(leaf.shape[0] + missing), leaf.shape[0] - 1)] if missing else leaf
