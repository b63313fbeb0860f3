"""How programs are compiled here: quickly, once, and kept on disk; and how long that took."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import jax

#: Recorded by who waits for a program that is compiled in the background.
WAITING = "/upslope/compile/waiting_duration"

_COMPILE_EVENTS = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)


@dataclass
class CompileClock:
    """What was spent on tracing and compiling.

    Attributes:
        spans: begin and end of every piece of that work in the clock's own thread, and of every wait for another
            thread's, in seconds; pieces can lie within others.
        programs: how many programs were compiled, or fetched from disk, by all threads.
        began: when the clock was started.
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
        """All other wall-clock seconds by now, compiling apart."""
        return time.perf_counter() - self.began - self.seconds


@contextmanager
def compile_clock() -> Iterator[CompileClock]:
    """Measures what this thread spends on compiling inside the ``with`` block, or on waiting for it."""
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


def set_up_devices(cache: Path | None = None) -> None:
    """One CPU device per core, and compiled programs kept on disk. Call it before JAX first runs anything.

    Args:
        cache: folder of compiled programs; the user's cache folder by default, or ``UPSLOPE_CACHE``.
    """
    jax.config.update("jax_num_cpu_devices", _cores())
    folder = cache or Path(os.environ.get("UPSLOPE_CACHE", Path.home() / ".cache" / "upslope" / "programs"))
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
