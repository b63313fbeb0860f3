"""Host families under JAX's abstract evaluation: shapes, where the loop asks for them; an error anywhere else."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax

from upslope.errors import UpslopeError

_SHAPES_ONLY: ContextVar[bool] = ContextVar("shapes_only", default=False)


@contextmanager
def shapes_only() -> Iterator[None]:
    """While inside, host families answer JAX's abstract evaluation with zeros of the right shapes."""
    token = _SHAPES_ONLY.set(True)
    try:
        yield
    finally:
        _SHAPES_ONLY.reset(token)


def evaluated_abstractly(*inputs: Any) -> bool:
    """Whether this is an abstract evaluation; a compiled program must not contain host environments."""
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs)):
        return False
    if not _SHAPES_ONLY.get():
        raise UpslopeError(
            "Host environments can't run inside a compiled program: call this without jit and vmap, "
            "or use upslope.meta_train, upslope.train and upslope.adapt, which know how."
        )
    return True
