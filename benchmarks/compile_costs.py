"""The time that each call of a job spends on tracing, lowering and compiling or loading, from JAX's own events."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from benchmarks import harness
from benchmarks.harness import Row
from upslope.run.compiling import compile_clock

#: Columns by JAX's events. Programs may be made in the background, so these can pass while the job runs.
EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing, s",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering, s",
    "/jax/core/compile/backend_compile_duration": "compiling or loading, s",
}
WAITED = "waited for all three, s"


@dataclass
class Forgetful:
    """A job in a process that has compiled nothing yet: with an empty cache folder each time, or with one that fills.

    Attributes:
        job: what is done.
        empty: whether each call finds an empty folder.
        found: the columns of each call.
    """

    job: Callable[[], Any]
    empty: bool
    found: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.folder = harness.scratch()

    def __call__(self) -> None:
        """Does the job, programs forgotten."""
        jax.clear_caches()
        folder = harness.scratch() if self.empty else self.folder
        jax.config.update("jax_compilation_cache_dir", str(folder))
        compilation_cache.reset_cache()
        spans: dict[tuple[str, int], list[tuple[float, float]]] = {}

        def listen(event: str, duration_secs: float, **_: str | int) -> None:
            if event in EVENTS:
                now = time.perf_counter()
                spans.setdefault((EVENTS[event], threading.get_ident()), []).append((now - duration_secs, now))

        jax.monitoring.register_event_duration_secs_listener(listen)
        try:
            with compile_clock() as clock:
                self.job()
        finally:
            jax.monitoring.unregister_event_duration_listener(listen)
        found = {column: sum(covered(spans[key]) for key in spans if key[0] == column) for column in EVENTS.values()}
        self.found.append(found | {WAITED: clock.seconds})

    def columns(self) -> Row:
        """Medians of all calls but the first, which always finds an empty folder."""
        return {key: float(np.median([each[key] for each in self.found[1:]])) for key in self.found[0]}


def covered(spans: list[tuple[float, float]]) -> float:
    """Seconds within any of the spans ``(begin, end)``, which may lie within each other."""
    total, until = 0.0, float("-inf")
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, until))
        until = max(until, end)
    return total
