"""How fast maps are generated, planned in, measured and played.

``python -m benchmarks.maps`` writes ``benchmarks/results/maps.json``.
"""

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from upslope.measures import truths
from upslope.planning import solve_all
from upslope.run.compiling import compile_clock, set_up_devices
from upslope.run.machine import hardware, versions
from upslope.tasks import JaxTasks, clean_maps, grid_games, obstacle_maps

RESULTS = Path(__file__).parent / "results" / "maps.json"


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 5
    """Of each part, after one run that compiles."""


def main(options: Options) -> None:
    """Times all parts, in turns."""
    set_up_devices(Path(tempfile.mkdtemp()))
    slippery = grid_games(traps=0.1, slip=0.2)
    parts = {
        "generate 4,000 distinct 8×8 training maps": lambda: obstacle_maps("train"),
        "generate 800 distinct 10×10 training maps": lambda: clean_maps("train"),
        "value iteration, 4,000 obstacle maps": planning(obstacle_maps()),
        "value iteration, 4,000 slippery maps with traps": planning(slippery),
        "truths for measures, 4,000 obstacle maps": knowing(obstacle_maps()),
        "1,000 steps of 1 game": playing(1),
        "1,000 steps of 200 games": playing(200),
        "100 steps of 20,000 games": playing(20_000, 100),
    }
    compiling, seconds = {}, {name: [] for name in parts}
    for name, part in parts.items():
        with compile_clock() as clock:
            jax.block_until_ready(part())
        compiling[name] = clock.seconds
    for _ in range(options.repeats):
        for name, part in parts.items():
            began = time.perf_counter()
            jax.block_until_ready(part())
            seconds[name].append(time.perf_counter() - began)
    rows = {
        name: {
            "median": float(np.median(times)),
            "fastest": min(times),
            "slowest": max(times),
            "compiling": compiling[name],
        }
        for name, times in seconds.items()
    }
    RESULTS.parent.mkdir(exist_ok=True)
    content = {"rows": rows, "repeats": options.repeats, "versions": versions(), "hardware": hardware()}
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    table = Table("", "seconds", "range", "before it, compiling", title="Maps")
    for name, row in rows.items():
        span = f"{row['fastest']:.3f} to {row['slowest']:.3f}"
        table.add_row(name, f"{row['median']:.3f}", span, f"{row['compiling']:.1f}")
    Console().print(table)
    print(f"Written to {RESULTS}.")


def planning(family: JaxTasks) -> Callable[[], Any]:
    """V* and Q* of 4,000 maps."""
    maps = jax.jit(lambda key: family.sample_many(key, 4000))(jax.random.key(0))
    return lambda: solve_all(family.env, maps, family.gamma)


def knowing(family: JaxTasks) -> Callable[[], Any]:
    """All that `upslope.measures` needs to know of 4,000 maps, once."""
    maps = jax.jit(lambda key: family.sample_many(key, 4000))(jax.random.key(0))
    return lambda: truths(family.env, maps, family.gamma)


def playing(games: int, steps: int = 1000) -> Callable[[], Any]:
    """Random moves, observations made at every step and summed up, so that nothing is left out."""
    family = obstacle_maps()
    maps = jax.jit(lambda key: family.sample_many(key, games))(jax.random.key(0))

    @jax.jit
    def play(key: jax.Array, maps: Any) -> jax.Array:
        running = family.reset(key, maps)

        def one_step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
            running, total = carry
            running, steps = family.collect(key, maps, running, wander, 1)
            return (running, total + jnp.sum(steps.reward) + jnp.sum(steps.next_obs)), None

        return jax.lax.scan(one_step, (running, jnp.zeros(())), jax.random.split(key, steps))[0][1]

    return lambda: play(jax.random.key(1), maps)


def wander(key: jax.Array, obs: jax.Array) -> jax.Array:
    """A random action for each game."""
    return jax.random.randint(key, obs.shape[:1], 0, 4)


if __name__ == "__main__":
    main(tyro.cli(Options))
