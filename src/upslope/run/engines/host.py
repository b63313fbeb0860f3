"""The engine for environments on the host: learners gather experience in Python and learn in one compiled update."""

import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from upslope.compiler_options import QUICK_TO_RUN
from upslope.run.engines.engine import AbstractEngine, Chunk
from upslope.run.health import all_finite
from upslope.tasks.abstract_evaluation import shapes_only
from upslope.types import Keys, Metrics

Count = Int[Array, ""]


class HostEngine(AbstractEngine):
    """Runs task learners one after the other, on one device. Their family closes its environments at the end."""

    restores_episodes: ClassVar[bool] = False

    def device_count(self, learners: int) -> int:
        del learners
        return 1

    def spread(self, learners: Any, batch: Any) -> Any:
        del learners
        return jax.tree.map(jnp.asarray, batch)

    def compile(self, learners: Any, keys: Keys) -> None:
        """Does nothing: an update is compiled with the first experience."""

    def start(self, learners: Any, keys: Keys) -> tuple[Any, Metrics]:
        states = [_item(learners, index).init(keys[index]) for index in range(len(keys))]
        _, totals, _ = self.shapes(learners, keys)
        # Copies, because a learner may start with one array in several places, and an update consumes its input.
        return _stack(states), jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), totals)

    def advance(
        self, learners: Any, states: Any, totals: Metrics, steps: int, *, fresh: bool, report: bool
    ) -> Chunk:  # fmt: skip
        after, sums, broken, reports = [], [], [], []
        for index in range(jax.tree.leaves(totals)[0].shape[0]):
            learner, state, total = _item(learners, index), _copy(states, index), _copy(totals, index)
            total = jax.tree.map(jnp.zeros_like, total) if fresh else total
            done = bad = jnp.zeros((), jnp.int32)
            gathered = learner.gather(state) if steps else None
            for left in reversed(range(steps)):
                ahead = learner.gather_ahead(state) if left else None
                # Runs in the background: nothing here waits for its result except what is gathered with it.
                state, total, done, bad = _update(learner, state, gathered, total, done, bad)
                if left:
                    gathered = learner.gather(state) if ahead is None else ahead()
            after.append(state)
            sums.append(total)
            broken.append(bad)
            reports.append(learner.report(state) if report else None)
        return Chunk(_stack(after), _stack(sums), jnp.stack(broken), _stack(reports) if report else {})

    def shapes(self, learners: Any, keys: Keys) -> tuple[Any, Any, Any]:
        learner, count = _item(learners, 0), len(keys)
        with shapes_only():
            state = jax.eval_shape(learner.init, keys[0])
            shapes = state, jax.eval_shape(learner.step, state)[1], jax.eval_shape(learner.report, state)
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape), leaf.dtype), shapes)

    def close(self, learners: Any) -> None:
        learners.family.close()


@functools.partial(jax.jit, donate_argnames=("state", "total"), compiler_options=QUICK_TO_RUN)
def _update(
    learner: Any, state: Any, gathered: Any, total: Metrics, done: Count, bad: Count
) -> tuple[Any, Metrics, Count, Count]:
    """One update. Counts the steps done, and notes the first one with a metric that is not finite."""
    state, metrics = learner.update(state, gathered)
    done = done + 1
    return state, jax.tree.map(jnp.add, total, metrics), done, jnp.where((bad == 0) & ~all_finite(metrics), done, bad)


def _item(learners: Any, index: int) -> Any:
    """One learner of a stack."""
    return jax.tree.map(lambda leaf: leaf[index] if np.ndim(leaf) else leaf, learners)


def _copy(batch: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: jnp.copy(leaf[index]), batch)


def _stack(items: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *items)
