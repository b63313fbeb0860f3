"""How learners lie on the machine: their batch axes as one, padded, and with what drives them."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from upslope.learners.learner import AbstractLearner, AbstractTaskLearner
from upslope.run.engines import compiled as chunks
from upslope.run.engines import host as host_chunks
from upslope.run.randomness import unrolled
from upslope.types import Keys


def laid_out(learners: AbstractLearner, keys: Keys) -> tuple[Any, AbstractLearner, Keys]:
    """What drives the learners; the learners and their keys with one axis for all batch axes, padded and in place."""
    batch, count = keys.shape, math.prod(keys.shape)
    on_host = isinstance(learners, AbstractTaskLearner) and learners.family.engine == "host"
    engine: Any = host_chunks if on_host else chunks

    def flatten(leaf: Any) -> Any:
        # By NumPy, because JAX would compile a program for each shape.
        leaf = leaf if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else np.asarray(leaf)
        return padded(leaf.reshape(count, *leaf.shape[len(batch) :]), engine)

    learners = jax.tree.map(lambda leaf: flatten(leaf) if np.ndim(leaf) else leaf, learners)
    return engine, *engine.spread(learners, (learners, flatten(unrolled(keys))))


def padded(leaf: Any, engine: Any) -> Any:
    """Repeats the last learner until the devices divide their number."""
    missing = -leaf.shape[0] % engine.devices(leaf.shape[0])
    return leaf[np.minimum(np.arange(leaf.shape[0] + missing), leaf.shape[0] - 1)] if missing else leaf
