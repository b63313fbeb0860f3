"""Algorithm 1 on CartPole against PyTorch, plain and careful; and whether all of them learn the same.

``python -m benchmarks.meta_training`` writes ``benchmarks/results/meta_training.json``. PyTorch takes part where it is
installed (``pip install torch==2.13.0``).
"""

import importlib.util
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import tyro

from benchmarks import harness, learning_curves
from benchmarks.compile_costs import WAITED, Forgetful
from benchmarks.harness import Bar, Part, Row, number
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast, run
from upslope.tasks import cartpoles

RECIPE = MetaTrainingConfig()

PLAIN, CAREFUL = "PyTorch, plain", "PyTorch, careful"
COLD, WARM = "upslope, 1 seed, compiling, no cache", "upslope, 1 seed, compiling, filled cache"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        seeds: how many at once.
        plain_iterations: of the plain peer in one repeat; the whole is extrapolated.
        careful_iterations: of the careful one.
        many_iterations: of ours with more than ten seeds; extrapolated too.
        curve_iterations: length of the shortened runs that are compared by what they learned; 0 for none.
        curve_every: iterations between the points of their curves.
        curve_seeds: of ours, of the careful peer and of the plain one.
    """

    seeds: tuple[int, ...] = (1, 5, 50)
    plain_iterations: int = 5
    careful_iterations: int = 50
    many_iterations: int = 100
    curve_iterations: int = 120
    curve_every: int = 30
    curve_seeds: tuple[int, int, int] = (20, 20, 8)


QUICK = {"repeats": 1, "seeds": (1,), "plain_iterations": 1, "careful_iterations": 2, "curve_iterations": 10,
         "curve_every": 5, "curve_seeds": (2, 1, 1)}  # fmt: skip


def main(options: Options) -> None:
    """Times everything in turns, then compares what was learned."""
    options = replace(options, **QUICK) if options.quick else options
    set_up_devices(harness.scratch())
    config = replace(RECIPE, iterations=20) if options.quick else RECIPE
    lengths = {n: options.many_iterations if n > 10 else config.iterations for n in options.seeds}
    parts = {seeds_row(n): Part(ours(config, n, lengths[n])) for n in options.seeds}
    parts["upslope, 1 seed, 50 snapshots tried"] = Part(ours(config, 1, every=config.snapshot_every))
    forgetful = {COLD: Forgetful(ours(config, 1), True), WARM: Forgetful(ours(config, 1), False)}
    parts |= {name: Part(job) for name, job in forgetful.items()}
    peers = peer_parts(config, options)
    parts |= {name: part for name, (part, _) in peers.items()}
    rows = harness.time_in_turns(parts, options.repeats)
    for name, job in forgetful.items():
        rows[name] |= job.columns()
    for name, (_, count) in peers.items():
        rows[name]["s an iteration"] = rows[name]["median"] / count
        rows[name]["s a seed, extrapolated"] = rows[name]["median"] / count * config.iterations
    for count, iterations in lengths.items():
        row = rows[seeds_row(count)]
        row["s an iteration"] = row["median"] / iterations
        name = "s a seed" if iterations == config.iterations else "s a seed, extrapolated"
        row[name] = row["median"] / iterations * config.iterations / count
    curves: dict[str, Any] = {}
    if options.curve_iterations:
        threads = 1 if fastest(rows, CAREFUL).endswith(thread_words(1)) else cores()
        curves = learning_curves.learned(options.curve_iterations, options.curve_every, options.curve_seeds, threads)
    found = [*bars(rows), *learning_curves.bars(curves)]
    harness.write("meta_training", options, rows, bars=found, curves=curves)


def seeds_row(count: int) -> str:
    """The name of a row of ours."""
    return f"upslope, {harness.counted(count, 'seed')}"


def ours(
    config: MetaTrainingConfig, seeds: int, iterations: int | None = None, every: int | None = None
) -> Callable[[], Any]:
    """Algorithm 1 with the default recipe; snapshots are tried every few iterations, or first and last only."""
    iterations = iterations or config.iterations
    learners = broadcast(MetaTraining(cartpoles(), config), (seeds,))
    keys = jax.random.split(jax.random.key(0), seeds)
    return lambda: run(learners, keys, updates=iterations, every=every or iterations)


def peer_parts(config: MetaTrainingConfig, options: Options) -> dict[str, tuple[Part, int]]:
    """The peers and their iterations in a repeat; none if PyTorch is not installed.

    The careful ones take one thread, and as many as there are cores: small products are often slower with several.
    """
    if importlib.util.find_spec("torch") is None:
        return {}
    import torch

    from benchmarks.peers.careful_meta_training import CarefulMetaTraining
    from benchmarks.peers.plain_meta_training import PlainMetaTraining

    def part(peer: Any, iterations: int, threads: int) -> tuple[Part, int]:
        def go() -> None:
            torch.set_num_threads(threads)
            peer.iterate(iterations)

        return Part(go), iterations

    found = {PLAIN: part(PlainMetaTraining(config), options.plain_iterations, cores())}
    for threads in sorted({1, cores()}):
        for how, compiled in (("", False), (", torch.compile", True)):
            peer = CarefulMetaTraining(config, compiled=compiled)
            found[f"{CAREFUL}{how}, {thread_words(threads)}"] = part(peer, options.careful_iterations, threads)
    return found


def thread_words(threads: int) -> str:
    """How a row's name says its threads."""
    return harness.counted(threads, "thread")


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fastest(rows: dict[str, Row], beginning: str) -> str:
    """The fastest row of those whose names begin so; an empty name if there is none."""
    found = [name for name in rows if name.startswith(beginning)]
    return min(found, key=lambda name: rows[name]["s an iteration"], default="")


def bars(rows: dict[str, Row]) -> list[Bar]:
    """The issue's five."""
    once, warm, steady = (rows[name]["median"] for name in (COLD, WARM, "upslope, 1 seed"))
    plain = rows.get(PLAIN, {}).get("s a seed, extrapolated")
    best = fastest(rows, CAREFUL)
    careful = rows[best]["s a seed, extrapolated"] if best else None
    several = [row[key] for name, row in rows.items() for key in row if "seeds" in name and "s a seed" in key]
    many = min(several, default=None)
    with_best = f" (the fastest: {best.removeprefix('PyTorch, ')})" if best else ""
    return [
        Bar("At least 100 × the plain one after compiling, one seed", _over(plain, steady), 100, bound=_STEPS),
        Bar("The same, per seed, many seeds at once", _over(plain, many), 100, bound=_WORK),
        Bar("At least 15 × with a cold compile", _over(plain, once), 15, bound=_compiling(rows[COLD], plain, 15)),
        Bar("At least 50 × with a filled cache", _over(plain, warm), 50, bound=_compiling(rows[WARM], plain, 50)),
        Bar(f"At least 5 × the careful one{with_best}, one seed", _over(careful, steady), 5, bound=_STEPS),
    ]


_STEPS = (
    "arithmetic and small kernels: by the profile, half of an iteration goes into 4 gradients of 640 transitions, tanh "
    "included, and a good third is collecting, 200 steps after one another of ten poles each. How much of either is "
    "launching kernels is not measured"
)
_WORK = "arithmetic of many small products, and memory: see the profile"


def _compiling(row: Row, plain: float | None, needed: float) -> str:
    """Where the seconds of a run go that compiles, from its own columns."""
    python, backend = row["tracing, s"] + row["lowering, s"], row["compiling or loading, s"]
    allowed = f", of {number(plain / needed)} that the bar allows" if plain else ""
    return (
        f"of {number(row['median'])} s a run{allowed}, {number(row[WAITED])} are waiting for programs; tracing and "
        f"lowering them in Python, which the cache does not keep, take {number(python)}, compiling or loading "
        f"{number(backend)} (in any thread)"
    )


def _over(peer: float | None, own: float | None) -> float | None:
    return None if peer is None or own is None else peer / own


if __name__ == "__main__":
    main(tyro.cli(Options))
