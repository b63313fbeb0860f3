"""Vector environments whose workers are processes of their own, and may die. Needs no JAX."""

from collections.abc import Callable
from typing import Any, TypeVar

from upslope.errors import UpslopeError

Result = TypeVar("Result")


class DeadWorkerError(UpslopeError):
    """A process that ran an environment is gone."""


def alive(call: Callable[..., Result], *inputs: Any) -> Result:
    """Calls a vector environment.

    Raises:
        DeadWorkerError: the pipe to a worker is broken: the worker has died.
    """
    try:
        return call(*inputs)
    except (EOFError, BrokenPipeError, ConnectionResetError) as error:
        raise DeadWorkerError(
            f"A worker process of the vector environment died ({type(error).__name__}): run the environment alone "
            "in a SyncVectorEnv to see why; running out of memory is the usual cause."
        ) from error
