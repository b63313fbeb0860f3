"""How fast maps are generated, planned in, measured and played, and DQN learns on them.

``python -m benchmarks.maps`` writes ``benchmarks/results/maps.json``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import tyro

from benchmarks import harness
from benchmarks.going import Going
from benchmarks.harness import Bar, Part
from upslope.learners.dqn import DQN, for_maps
from upslope.planning.exact import solve_all
from upslope.planning.measures import truths
from upslope.run.compiling import set_up_devices
from upslope.tasks import JaxTasks, clean_maps, grid_games, obstacle_maps
from upslope.types import Keys


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        maps: planned in and measured at once.
        learners: DQNs with the paper's convolutional network, each on its own map, compared with one alone.
        updates: of each of them; figures evaluate every 25.
    """

    maps: int = 4000
    learners: int = 200
    updates: int = 25


def main(options: Options) -> None:
    """Times all parts, in turns."""
    set_up_devices(harness.scratch())
    count, steps = (50, 10) if options.quick else (options.maps, 1000)
    learners, updates = (2, 2) if options.quick else (options.learners, options.updates)
    slippery = grid_games(traps=0.1, slip=0.2)
    parts = {
        GENERATED: lambda: obstacle_maps("train"),
        "generate 800 distinct 10×10 training maps": lambda: clean_maps("train"),
        f"value iteration, {count:,} obstacle maps": planning(obstacle_maps(), count),
        f"value iteration, {count:,} slippery maps with traps": planning(slippery, count),
        f"truths for measures, {count:,} obstacle maps": knowing(obstacle_maps(), count),
        f"{steps:,} steps of 1 game": playing(1, steps),
        f"{steps:,} steps of 200 games": playing(200, steps),
        f"{steps // 10:,} steps of 20,000 games": playing(20_000, steps // 10),
    }
    waited = {name: Part(lambda part=part: jax.block_until_ready(part())) for name, part in parts.items()}
    for number, chunks in ((1, 10), (learners, 1)):
        going = Going(*learning(number))
        name = f"{chunks} × {updates} updates of {number} DQN{'s' * (number > 1)} on obstacle maps"
        waited[name] = Part(
            lambda going=going, chunks=chunks: [going.advance(updates) for _ in range(chunks)],
            {"learner-updates": number * chunks * updates},
        )
    rows = harness.time_in_turns(waited, options.repeats)
    alone, together = (row["learner-updates/s"] for row in rows.values() if "learner-updates/s" in row)
    bars = [
        Bar(
            f"{learners} DQNs: an update costs at most half as much per learner as for one alone",
            alone / together,
            0.5,
            True,
            _BOUND,
        ),
        Bar("4,000 distinct maps: at most 2 s", rows[GENERATED]["median"], 2, at_most=True),
        Bar(
            "4,000 distinct maps the first time, compiling included: at most 2 s",
            rows[GENERATED]["first_call"],
            2,
            True,
            f"compiling: {rows[GENERATED]['compiling']:.1f} s, of which a filled cache saves a part",
        ),
    ]
    harness.write("maps", options, rows, bars=bars)


GENERATED = "generate 4,000 distinct 8×8 training maps"
_BOUND = (
    "arithmetic: one learner's products, with weights that no other shares, keep a core busy, and two cores are all "
    "there is to gain, of which threads within its products give one alone a part"
)


def learning(count: int) -> tuple[DQN, Keys]:
    """DQNs on maps with obstacles, and their keys ``[count]``."""
    family = obstacle_maps()
    learners = DQN(family, many(family, count), None, for_maps())
    return learners, jax.random.split(jax.random.key(2), count)


def planning(family: JaxTasks, count: int) -> Callable[[], Any]:
    """V* and Q* of a batch of maps."""
    maps = many(family, count)
    return lambda: solve_all(family.env, maps, family.gamma)


def knowing(family: JaxTasks, count: int) -> Callable[[], Any]:
    """Everything that `upslope.planning.measures` needs of a batch of maps."""
    maps = many(family, count)
    return lambda: truths(family.env, maps, family.gamma)


def many(family: JaxTasks, count: int) -> Any:
    """Stacked maps ``[count, ...]``."""
    return jax.jit(lambda key: family.sample_many(key, count))(jax.random.key(0))


def playing(games: int, steps: int) -> Callable[[], Any]:
    """Random moves, observations made at every step and summed up, so that nothing is left out."""
    family = obstacle_maps()
    maps = many(family, games)

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
