"""Chunks of steps for learners whose environments run on the host: gathered in Python, learned from in one program.

The same functions as `upslope.run.engines.compiled`, so the loop need not know which it drives.
Learners take turns.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from upslope.compiler_options import QUICK_TO_RUN
from upslope.learners.learner import AbstractTaskLearner
from upslope.run.engines.compiled import Chunk
from upslope.tasks.abstract_evaluation import shapes_only
from upslope.types import Keys, Metrics

Count = Int[Array, ""]


def devices(learners: int) -> int:
    """One learner at a time."""
    del learners
    return 1


def spread(learners: AbstractTaskLearner, batch: Any) -> Any:
    """Nothing is spread over devices."""
    del learners
    return jax.tree.map(jnp.asarray, batch)


def start(learners: AbstractTaskLearner, keys: Keys) -> tuple[Any, Metrics]:
    """The states ``[learners, ...]`` before the first step, and the metrics' sums, all zero."""
    states = [_one(learners, index).init(keys[index]) for index in range(len(keys))]
    _, totals, _ = shapes(learners, keys)
    # Copies, because learners begin with one array in several places, and an update consumes the arrays it is given.
    return _stacked(states), jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), totals)


def advance(
    learners: AbstractTaskLearner, states: Any, totals: Metrics, steps: int, *, fresh: bool, report: bool
) -> Chunk:
    """Takes ``steps`` steps with every learner; see `upslope.run.engines.compiled.advance`."""
    after, sums, broken, told = [], [], [], []
    for index in range(jax.tree.leaves(totals)[0].shape[0]):
        learner, state, total = _one(learners, index), _taken(states, index), _taken(totals, index)
        total = jax.tree.map(jnp.zeros_like, total) if fresh else total
        done = bad = jnp.zeros((), jnp.int32)
        gathered = learner.gather(state) if steps else None
        for left in reversed(range(steps)):
            ahead = learner.gather_ahead(state) if left else None
            # In the background: nothing here waits for its result but what is gathered with it.
            state, total, done, bad = _update(learner, state, gathered, total, done, bad)
            if left:
                gathered = learner.gather(state) if ahead is None else ahead()
        after.append(state)
        sums.append(total)
        broken.append(bad)
        told.append(learner.report(state) if report else None)
    return Chunk(_stacked(after), _stacked(sums), jnp.stack(broken), _stacked(told) if report else {})


def shapes(learners: AbstractTaskLearner, keys: Keys) -> tuple[Any, Any, Any]:
    """What states, totals and reports look like, without computing any ``[learners, ...]``."""
    learner, count = _one(learners, 0), len(keys)
    with shapes_only():
        state = jax.eval_shape(learner.init, keys[0])
        found = state, jax.eval_shape(learner.step, state)[1], jax.eval_shape(learner.report, state)
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape), leaf.dtype), found)


def close(learners: AbstractTaskLearner) -> None:
    """Closes the environments."""
    family: Any = learners.family
    family.close()


@functools.partial(jax.jit, donate_argnames=("state", "total"), compiler_options=QUICK_TO_RUN)
def _update(
    learner: AbstractTaskLearner, state: Any, gathered: Any, total: Metrics, done: Count, bad: Count
) -> tuple[Any, Metrics, Count, Count]:
    """One update; counts the steps done, and tells the first with a metric that was not finite."""
    state, metrics = learner.update(state, gathered)
    finite = jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(metrics)]).all()
    done = done + 1
    return state, jax.tree.map(jnp.add, total, metrics), done, jnp.where((bad == 0) & ~finite, done, bad)


def _one(learners: AbstractTaskLearner, index: int) -> AbstractTaskLearner:
    return jax.tree.map(lambda leaf: leaf[index] if np.ndim(leaf) else leaf, learners)


def _taken(batch: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: jnp.copy(leaf[index]), batch)


def _stacked(items: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *items)
