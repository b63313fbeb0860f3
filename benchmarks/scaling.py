"""How time grows with the number of tasks, of seeds, of inner steps, and with the size of maps, each with its exponent.

``python -m benchmarks.scaling`` writes ``benchmarks/results/scaling.json``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np
import tyro

from benchmarks import harness
from benchmarks.going import Going
from benchmarks.harness import Bar, Part, Row
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.recipes import for_grid_games
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast
from upslope.tasks import cartpoles, grid_games


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        tasks: of one meta-iteration on CartPole.
        seeds: meta-trained together.
        inner_steps: N.
        sizes: rows, and columns, of maps.
    """

    tasks: tuple[int, ...] = (10, 30, 100, 300, 1000)
    seeds: tuple[int, ...] = (1, 3, 10, 30, 100)
    inner_steps: tuple[int, ...] = (1, 3, 10)
    sizes: tuple[int, ...] = (8, 16, 32)


#: Trials of snapshots are not part of an iteration, but of the program: small ones compile faster.
SMALL = {"evaluation_tasks": 1, "evaluation_episodes": 1}
RECIPE = MetaTrainingConfig(**SMALL)


def main(options: Options) -> None:
    """Times one iteration at each point of the four series, in turns."""
    if options.quick:
        options = replace(options, repeats=1, tasks=(2, 4), seeds=(), inner_steps=(), sizes=(4, 5))
    set_up_devices(harness.scratch())
    series = {
        "tasks": {n: (cartpole(replace(RECIPE, tasks=n)), max(5, 200 // n)) for n in options.tasks},
        "seeds": {n: (cartpole(RECIPE, n), max(5, 100 // n)) for n in options.seeds},
        "inner steps": {n: (cartpole(replace(RECIPE, inner_steps=n)), 20) for n in options.inner_steps},
        "cells of a map": {n * n: (maps(n), max(2, 1300 // n**2)) for n in options.sizes},
    }
    parts, runs = {}, {}
    for name, points in series.items():
        for n, (make, iterations) in points.items():
            parts[f"{name}: {n:,}"] = Part(_lazy(make, iterations))
            runs[f"{name}: {n:,}"] = iterations
    rows = harness.time_in_turns(parts, options.repeats)
    for name, row in rows.items():
        row["seconds"] = [seconds / runs[name] for seconds in row["seconds"]]
        row |= harness.spread(row["seconds"])
    fits = {name: fit(rows, name, list(points)) for name, points in series.items() if len(points) > 1}
    harness.write("scaling", options, rows, bars=bars(fits), fits=fits, unit="s an iteration")


def cartpole(config: MetaTrainingConfig, seeds: int = 1) -> Callable[[], Going]:
    """Algorithm 1 on CartPole."""
    learners = broadcast(MetaTraining(cartpoles(), config), (seeds,))
    return lambda: Going(learners, jax.random.split(jax.random.key(0), seeds))


def maps(size: int) -> Callable[[], Going]:
    """Algorithm 1 on maps of this size, with the recipe for grid games."""
    config = replace(for_grid_games(100), **SMALL)
    learners = broadcast(MetaTraining(grid_games((size, size)), config), (1,))
    return lambda: Going(learners, jax.random.split(jax.random.key(0), 1))


def _lazy(make: Callable[[], Going], iterations: int) -> Callable[[], None]:
    """Compiles in its first call."""
    made: list[Going] = []

    def advance() -> None:
        if not made:
            made.append(make())
        made[0].advance(iterations)

    return advance


def fit(rows: dict[str, Row], name: str, points: list[int]) -> dict[str, float]:
    """Exponents of a power law: through the medians, through the last two of them, and through the fastest repeats."""
    sizes = np.log(points)
    medians, fastest = (np.log([rows[f"{name}: {n:,}"][which] for n in points]) for which in ("median", "fastest"))
    last = (medians[-1] - medians[-2]) / (sizes[-1] - sizes[-2])
    return {
        "exponent": float(np.polyfit(sizes, medians, 1)[0]),
        "exponent of the last two": float(last),
        "exponent of the fastest": float(np.polyfit(sizes, fastest, 1)[0]),
    }


def bars(fits: dict[str, dict[str, float]]) -> list[Bar]:
    """At most linear, with a tenth for noise; none for maps, whose arithmetic grows with the square of their cells."""
    found = []
    for name in [name for name in fits if name in _WHY]:
        exponents = fits[name]
        others = (
            f"{exponents['exponent']:.2f} of the medians, {exponents['exponent of the last two']:.2f} of the last two "
            f"of them, {exponents['exponent of the fastest']:.2f} of the fastest repeats"
        )
        found.append(
            Bar(
                f"Time grows at most linearly in {name} (exponent of all points, 0.1 for noise)",
                exponents["exponent"],
                1.1,
                at_most=True,
                bound=f"{_WHY[name]}; exponents: {others}",
                close=exponents["exponent"] > 1,
            )
        )
    return found


_WHY = {
    "tasks": "probably memory: the replays and gradients of many tasks need more than the caches hold",
    "seeds": "probably memory: states and replays of many seeds need more than the caches hold",
    "inner steps": "not known",
}


if __name__ == "__main__":
    main(tyro.cli(Options))
