"""Failures of vector environments: a worker process may die, and an observation may change its shape. No JAX."""

from collections.abc import Callable
from typing import Any, TypeVar

from gymnasium.error import ClosedEnvironmentError

from upslope.errors import UpslopeError

Result = TypeVar("Result")

# NumPy's messages when an observation does not fit into the array of all of them.
_MISFITS = ("could not broadcast", "Output array is the wrong shape", "must have the same shape")


class DeadWorkerError(UpslopeError):
    """A process that ran an environment has died."""


def call_workers(call: Callable[..., Result], *inputs: Any) -> Result:
    """Calls a vector environment.

    Raises:
        DeadWorkerError: the pipe to a worker is broken: the worker has died.
        UpslopeError: an observation has the wrong shape, or the vector environment is closed.
    """
    try:
        return call(*inputs)
    except (EOFError, BrokenPipeError, ConnectionResetError) as error:
        raise DeadWorkerError(
            f"A worker process of the vector environment died ({type(error).__name__}): run the environment alone "
            "in a SyncVectorEnv to see why; running out of memory is the usual cause."
        ) from error
    except ClosedEnvironmentError as error:
        raise UpslopeError(
            "The vector environment is closed, as happens after one of its workers died: make a new one."
        ) from error
    except ValueError as error:
        if not any(words in str(error) for words in _MISFITS):
            raise
        raise UpslopeError(
            f"An environment gave an observation of another shape than its observation space says ({error}): "
            "fix its observation_space, or what changes the observation's shape."
        ) from error


def call_or_end(env: Any, call: Callable[..., Result], *inputs: Any) -> Result:
    """Calls a vector environment. If a worker has died, it ends the others: they can neither continue nor be closed.

    Raises:
        UpslopeError: see `call_workers`.
    """
    try:
        return call_workers(call, *inputs)
    except DeadWorkerError:
        _end_workers(env.unwrapped)
        raise


def close_or_end(env: Any, close: Callable[[], Any]) -> None:
    """Closes a vector environment, or ends its workers if one has died."""
    try:
        call_or_end(env, close)
    except DeadWorkerError:
        return


def _end_workers(env: Any) -> None:
    """Kills the workers: closing waits for all of them, and the dead one never answers."""
    for worker in getattr(env, "processes", ()):
        worker.kill()
        worker.join()
        env.closed = True
