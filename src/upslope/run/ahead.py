"""Programs compiled ahead: a compiler keeps one core busy, and whoever runs or compiles meanwhile leaves one idle."""

import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import TracebackType
from typing import Any

import jax

from upslope.run.compiling import WAITING


class Ahead:
    """Compiles in the background, in the order of submission. JAX keeps the programs for whoever calls them later.

    At the end of the ``with`` block what was not begun is dropped, and what was begun is waited for: it can't be
    stopped, and a process must not end amid it.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "compiling")
        self._futures: dict[Hashable, Future[None]] = {}

    def __enter__(self) -> "Ahead":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        del kind, error, traceback
        self._pool.shutdown(cancel_futures=True)

    def submit(self, name: Hashable, compile: Callable[[], None]) -> None:
        """Has something compiled, once for each name. If it fails, so will its caller, who can tell why."""
        if name not in self._futures:
            self._futures[name] = self._pool.submit(compile)

    def wait(self, name: Hashable) -> None:
        """Returns when that is compiled; at once, if nobody submitted it."""
        if name not in self._futures:
            return
        began = time.perf_counter()
        wait([self._futures[name]])
        jax.monitoring.record_event_duration_secs(WAITING, time.perf_counter() - began)


def shapes_of(tree: Any) -> Hashable:
    """What tells two programs of one function apart: the structure of their input, and its shapes."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
