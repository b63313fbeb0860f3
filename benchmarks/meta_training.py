"""Algorithm 1 on CartPole against PyTorch, plain and careful; and whether all of them learn the same.

``python -m benchmarks.meta_training`` writes ``benchmarks/results/meta_training.json``. PyTorch takes part where it is
installed (``pip install torch==2.13.0``).
"""

import importlib.util
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
import tyro
from jax.experimental.compilation_cache import compilation_cache

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row
from benchmarks.peers.numpy_cartpoles import greedy_returns, numpy_advantages, weights_of
from upslope.meta_training import MetaTraining
from upslope.recipes import MetaTrainingConfig
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast, run
from upslope.tasks import cartpoles

RECIPE = MetaTrainingConfig()

#: Poles, the same for all, on which what was learned is tried; between them they cover the family.
LENGTHS = np.linspace(0.25, 5.0, 40)

PLAIN, CAREFUL, COMPILED = "PyTorch, plain", "PyTorch, careful", "PyTorch, careful, torch.compile"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        seeds: how many at once.
        plain_iterations: of the plain peer in one repeat; the whole is extrapolated.
        careful_iterations: of the careful one.
        many_iterations: of ours with more than ten seeds; extrapolated too.
        curve_iterations: length of the shortened runs that are compared by what they learned; 0 for none.
        curve_seeds: of ours, of the careful peer and of the plain one.
    """

    seeds: tuple[int, ...] = (1, 5, 50)
    plain_iterations: int = 5
    careful_iterations: int = 50
    many_iterations: int = 100
    curve_iterations: int = 120
    curve_seeds: tuple[int, int, int] = (20, 8, 2)


QUICK = {"repeats": 1, "seeds": (1,), "plain_iterations": 1, "careful_iterations": 2, "curve_iterations": 10,
         "curve_seeds": (2, 1, 1)}  # fmt: skip


def main(options: Options) -> None:
    """Times everything in turns, then compares what was learned."""
    options = replace(options, **QUICK) if options.quick else options
    set_up_devices(harness.scratch())
    config = replace(RECIPE, iterations=20) if options.quick else RECIPE
    lengths = {n: options.many_iterations if n > 10 else config.iterations for n in options.seeds}
    parts = {seeds_row(n): Part(ours(config, n, lengths[n])) for n in options.seeds}
    parts["upslope, 1 seed, 50 snapshots tried"] = Part(ours(config, 1, every=config.snapshot_every))
    parts["upslope, 1 seed, compiling, no cache"] = Part(recompiling(ours(config, 1), empty=True))
    parts["upslope, 1 seed, compiling, filled cache"] = Part(recompiling(ours(config, 1), empty=False))
    peers = peer_kinds(config, options)
    parts |= {name: Part(lambda peer=peer, count=count: peer.iterate(count)) for name, (peer, count) in peers.items()}
    rows = harness.time_in_turns(parts, options.repeats)
    for name, (_, count) in peers.items():
        rows[name]["s an iteration"] = rows[name]["median"] / count
        rows[name]["s a seed, extrapolated"] = rows[name]["median"] / count * config.iterations
    for count, iterations in lengths.items():
        row = rows[seeds_row(count)]
        row["s an iteration"] = row["median"] / iterations
        name = "s a seed" if iterations == config.iterations else "s a seed, extrapolated"
        row[name] = row["median"] / iterations * config.iterations / count
    curves = learned(options) if options.curve_iterations else {}
    harness.write("meta_training", options, rows, bars=bars(rows, curves), curves=curves)


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


def recompiling(part: Callable[[], Any], *, empty: bool) -> Callable[[], Any]:
    """The same in a process that has compiled nothing yet: with an empty cache folder, or with one that is filled."""
    folder = tempfile.mkdtemp()

    def forgetful() -> Any:
        jax.clear_caches()
        jax.config.update("jax_compilation_cache_dir", tempfile.mkdtemp() if empty else folder)
        compilation_cache.reset_cache()
        return part()

    return forgetful


def peer_kinds(config: MetaTrainingConfig, options: Options) -> dict[str, tuple[Any, int]]:
    """The peers and their iterations in a repeat; none if PyTorch is not installed."""
    if importlib.util.find_spec("torch") is None:
        return {}
    from benchmarks.peers.careful_meta_training import CarefulMetaTraining
    from benchmarks.peers.plain_meta_training import PlainMetaTraining

    return {
        PLAIN: (PlainMetaTraining(config), options.plain_iterations),
        CAREFUL: (CarefulMetaTraining(config), options.careful_iterations),
        COMPILED: (CarefulMetaTraining(config, compiled=True), options.careful_iterations),
    }


def learned(options: Options) -> dict[str, Any]:
    """Mean greedy return over `LENGTHS` of each seed's averaged θ after a shortened run, by who trained it."""
    config = replace(RECIPE, iterations=options.curve_iterations)
    own, careful, plain = options.curve_seeds
    states = ours(config, own)().states
    found = {"upslope": []}
    for seed in range(own):
        average = jax.tree.map(lambda leaf, s=seed: np.asarray(leaf[s]), states.average)
        found["upslope"].append(_return_of(weights_of(average)))
    for name, count in ((CAREFUL, careful), (PLAIN, plain)):
        if importlib.util.find_spec("torch") is None:
            break
        found[name] = []
        for seed in range(count):
            peer, _ = peer_kinds(config, options)[name]
            peer = type(peer)(config, seed)
            peer.iterate(config.iterations)
            found[name].append(_return_of({k: w.detach().numpy() for k, w in peer.average.named_parameters()}))
    return {name: {"returns": values, "mean": float(np.mean(values))} for name, values in found.items()}


def bars(rows: dict[str, Row], curves: dict[str, Any]) -> list[Bar]:
    """The issue's five, and that all of them learn alike."""
    once = rows["upslope, 1 seed, compiling, no cache"]["median"]
    warm = rows["upslope, 1 seed, compiling, filled cache"]["median"]
    steady = rows["upslope, 1 seed"]["median"]
    plain = rows.get(PLAIN, {}).get("s a seed, extrapolated")
    careful = [rows[name]["s a seed, extrapolated"] for name in (CAREFUL, COMPILED) if name in rows]
    several = [row[key] for name, row in rows.items() for key in row if "seeds" in name and "s a seed" in key]
    many = min(several, default=None)
    found = [
        Bar("At least 100 × the plain one after compiling, one seed", _over(plain, steady), 100, bound=_STEPS),
        Bar("The same, a seed of many at once", _over(plain, many), 100, bound=_WORK),
        Bar("At least 15 × with a cold compile", _over(plain, once), 15, bound="compiling: see its column"),
        Bar("At least 50 × with a filled cache", _over(plain, warm), 50, bound=_TRACING),
        Bar("At least 5 × the careful one, one seed", _over(min(careful, default=None), steady), 5, bound=_STEPS),
    ]
    for name, curve in curves.items():
        if name != "upslope":
            gap = standard_errors_apart(curves["upslope"]["returns"], curve["returns"])
            what = f"{name} learns the same: means of shortened runs at most 3 standard errors apart"
            found.append(Bar(what, gap, 3, at_most=True))
    return found


_STEPS = (
    "launching and arithmetic, about half each: 100,000 environment steps follow one another, each of a few kernels on "
    "ten poles; and 2,000 gradients of 640 transitions, tanh included, keep one core busy (see the profile)"
)
_WORK = "arithmetic of many small products, and memory: see the profile"
_TRACING = "tracing and lowering in Python, which the cache does not keep: the `compiling` column of the warm row"


def standard_errors_apart(ours: list[float], theirs: list[float]) -> float | None:
    """How far two means lie apart, in standard errors of their difference; few values are given our spread."""
    if len(ours) < 2:
        return None
    spread = np.var(ours, ddof=1)
    other = np.var(theirs, ddof=1) if len(theirs) > 4 else spread
    error = np.sqrt(spread / len(ours) + other / len(theirs))
    return float(abs(np.mean(ours) - np.mean(theirs)) / max(error, 1e-9))


def _over(peer: float | None, own: float | None) -> float | None:
    return None if peer is None or own is None else peer / own


def _return_of(weights: dict[str, np.ndarray]) -> float:
    return float(np.mean(greedy_returns(numpy_advantages(weights), LENGTHS)))


if __name__ == "__main__":
    main(tyro.cli(Options))
