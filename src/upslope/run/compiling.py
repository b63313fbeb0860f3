"""How programs are compiled here: quickly, once, and kept on disk; and how long that took."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import jax

#: LLVM's first level compiles these programs in half the time, and they run as fast (docs/performance notes).
COMPILER_OPTIONS = {"xla_backend_optimization_level": 1}

_COMPILE_EVENTS = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)


@dataclass
class CompileClock:
    """Seconds spent tracing and compiling, and how many programs were compiled or fetched from disk."""

    seconds: float = 0.0
    programs: int = 0


@contextmanager
def compile_clock() -> Iterator[CompileClock]:
    """Measures what JAX spends on compiling inside the ``with`` block."""
    clock = CompileClock()

    def listen(event: str, seconds: float, **_: object) -> None:
        if event in _COMPILE_EVENTS:
            clock.seconds += seconds
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
    if "jax_num_cpu_devices" in jax.config.values and not jax.config.jax_num_cpu_devices > 1:
        jax.config.update("jax_num_cpu_devices", _cores())
    folder = cache or Path(os.environ.get("UPSLOPE_CACHE", Path.home() / ".cache" / "upslope" / "programs"))
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
