"""How programs are compiled: where they are cached, in the background, and how long it takes."""

import os
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import jax

#: Recorded for the time spent waiting for a program that is compiled in the background.
WAITING = "/upslope/compile/waiting_duration"

_COMPILE_EVENTS = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)


@dataclass
class CompileClock:
    """The time spent on tracing and compiling.

    Attributes:
        spans: start and end, in seconds, of each piece of that work in the clock's own thread, and of each wait for
            another thread's work; spans may overlap.
        programs: the number of programs compiled, or fetched from disk, by all threads.
        began: when the clock started.
    """

    spans: list[tuple[float, float]] = field(default_factory=list)
    programs: int = 0
    began: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """Wall-clock seconds in which something was traced or compiled."""
        total, covered = 0.0, float("-inf")
        for begin, end in sorted(self.spans):
            total += max(0.0, end - max(begin, covered))
            covered = max(covered, end)
        return total

    @property
    def seconds_running(self) -> float:
        """All other wall-clock seconds so far."""
        return time.perf_counter() - self.began - self.seconds


@contextmanager
def compile_clock() -> Iterator[CompileClock]:
    """Measures the time this thread spends on compiling, or waiting for it, inside the ``with`` block."""
    clock = CompileClock()
    own = threading.get_ident()

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event in (*_COMPILE_EVENTS, WAITING) and threading.get_ident() == own:
            now = time.perf_counter()
            clock.spans.append((now - duration_secs, now))
        clock.programs += event == _COMPILE_EVENTS[-1]

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield clock
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


class Ahead:
    """Compiles programs in the background, in the order of submission; JAX keeps them for later calls.

    A compiler keeps one core busy, so the other cores can run or compile something else.

    At the end of the ``with`` block, programs in the queue are dropped. The one being compiled is waited for: it can't
    be stopped, and a process must not end during it.
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
        """Compiles something, once for each name. A failure is ignored: the later call fails too, and reports it."""
        if name not in self._futures:
            self._futures[name] = self._pool.submit(compile)

    def wait(self, name: Hashable) -> None:
        """Waits until that is compiled; returns at once if it was never submitted."""
        if name not in self._futures:
            return
        began = time.perf_counter()
        wait([self._futures[name]])
        jax.monitoring.record_event_duration_secs(WAITING, time.perf_counter() - began)


def shapes_of(tree: Any) -> Hashable:
    """The structure and shapes of a program's input; together they tell two programs of one function apart."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)


def set_up_devices(cache: Path | None = None) -> None:
    """Makes one CPU device per core, and caches compiled programs on disk. Call it before JAX runs anything.

    Args:
        cache: folder of compiled programs; by default ``UPSLOPE_CACHE``, or the user's cache folder.
    """
    jax.config.update("jax_num_cpu_devices", _cores())
    folder = cache or Path(os.environ.get("UPSLOPE_CACHE", Path.home() / ".cache" / "upslope" / "programs"))
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
