"""Vector environments that fail: workers are processes of their own and may die, and shapes may change. No JAX."""

from collections.abc import Callable
from typing import Any, TypeVar

from gymnasium.error import ClosedEnvironmentError

from upslope.errors import UpslopeError

Result = TypeVar("Result")

# What numpy says when an observation does not fit into the array of all of them.
_MISFITS = ("could not broadcast", "Output array is the wrong shape", "must have the same shape")


class DeadWorkerError(UpslopeError):
    """A process that ran an environment is gone."""


def alive(call: Callable[..., Result], *inputs: Any) -> Result:
    """Calls a vector environment.

    Raises:
        DeadWorkerError: the pipe to a worker is broken: the worker has died.
        UpslopeError: an observation does not fit in, or the vector environment is closed.
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
            "The vector environment is closed, as it is after one of its workers died: make a new one."
        ) from error
    except ValueError as error:
        if not any(words in str(error) for words in _MISFITS):
            raise
        raise UpslopeError(
            f"An environment gave an observation of another shape than its observation space says ({error}): "
            "mend its observation_space, or what changes the observation's shape."
        ) from error


def call_or_end(env: Any, call: Callable[..., Result], *inputs: Any) -> Result:
    """Calls a vector environment; once it has lost a worker it can't go on, nor be closed: the others are ended.

    Raises:
        UpslopeError: see `alive`.
    """
    try:
        return alive(call, *inputs)
    except DeadWorkerError:
        _end_workers(env.unwrapped)
        raise


def close_or_end(env: Any, close: Callable[[], Any]) -> None:
    """Closes a vector environment, or ends what a dead worker has left of it."""
    try:
        call_or_end(env, close)
    except DeadWorkerError:
        return


def _end_workers(env: Any) -> None:
    """Kills them: asked to close, they would be waited for, and the dead one never answers."""
    for worker in getattr(env, "processes", ()):
        worker.kill()
        worker.join()
        env.closed = True
