"""Host families under JAX's abstract evaluation: shapes if the loop computes shapes, otherwise an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax

from upslope.errors import UpslopeError

_SHAPES_ONLY: ContextVar[bool] = ContextVar("shapes_only", default=False)


@contextmanager
def shapes_only() -> Iterator[None]:
    """Inside the ``with`` block, host families return zeros of the right shapes under abstract evaluation."""
    token = _SHAPES_ONLY.set(True)
    try:
        yield
    finally:
        _SHAPES_ONLY.reset(token)


def under_abstract_evaluation(*inputs: Any) -> bool:
    """Whether JAX evaluates the inputs abstractly, inside `shapes_only`.

    Raises:
        UpslopeError: they are evaluated abstractly elsewhere, for a compiled program.
    """
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs)):
        return False
    if not _SHAPES_ONLY.get():
        raise UpslopeError(
            "Host environments can't run inside a compiled program: call this without jit and vmap, "
            "or use upslope.meta_train, upslope.train and upslope.adapt, which run them outside."
        )
    return True
