"""Where the time of each main job goes, by phase: the step is cut off after each phase, and differences are taken.

``python -m benchmarks.profile`` writes ``benchmarks/results/profile.json``. Programs are those of `upslope.run` in
form: a loop of steps, mapped over learners, on one device.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks import harness
from benchmarks.harness import Part, Row
from benchmarks.phases import ADAPTATION_PHASES, DDPG_PHASES, DQN_PHASES, META_TRAINING, Phase
from upslope.adaptation.algorithm2 import Adaptation, AdaptationConfig
from upslope.compiler_options import QUICK_TO_COMPILE, QUICK_TO_RUN
from upslope.learners.ddpg import DDPG
from upslope.learners.dqn import DQN
from upslope.learners.learner import AbstractLearner
from upslope.learners.shaping import Shaping, potential_based
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.recipes import for_grid_games
from upslope.priors.potentials import mean_potential, stack
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast
from upslope.run.randomness import unroll
from upslope.tasks import cartpoles, obstacle_maps
from upslope.types import Keys


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        learners: DQNs and DDPGs trained together.
        jobs: which; all by default.
    """

    learners: int = 100
    jobs: tuple[str, ...] = ("Algorithm 1", "Algorithm 1 on maps", "DQN", "DDPG", "adaptation")


def main(options: Options) -> None:
    """Times all phases of all jobs in turns."""
    if options.quick:
        options = replace(options, repeats=1, learners=2)
    set_up_devices(harness.scratch())
    jobs = {name: make for name, make in all_jobs(options.learners).items() if name in options.jobs}
    parts: dict[str, Part] = {}
    counts: dict[str, int] = {}
    for job, make in jobs.items():
        learners, keys, phases, steps = make()
        steps = 1 if options.quick else steps
        for phase, part in cut_off(learners, keys, phases, steps).items():
            parts[f"{job}: {phase}"] = part
            counts[f"{job}: {phase}"] = steps
    rows = harness.time_in_turns(parts, options.repeats)
    harness.write("profile", options, differences(rows, counts), unit="ms a step")


def all_jobs(count: int) -> dict[str, Callable[[], tuple[AbstractLearner, Keys, Mapping[str, Phase], int]]]:
    """A stack of learners, their keys, the phases of their step, and how many steps make a repeat."""
    poles = cartpoles()
    tasks = poles.sample_many(jax.random.key(1), count)
    prior = MetaTraining(poles).init(jax.random.key(2)).theta

    def keys(count: int) -> Keys:
        return unroll(jax.random.split(jax.random.key(0), count))

    def shaping() -> Shaping:
        return broadcast(potential_based(mean_potential(stack([prior] * 5))), (count,))

    def adaptation() -> AbstractLearner:
        learner = Adaptation(
            poles,
            poles.sample(jax.random.key(1)),
            prior,
            jnp.asarray(1e-3),
            config=AdaptationConfig(evaluation_episodes=1),
        )
        return broadcast(learner, (count,))

    return {
        "Algorithm 1": lambda: (broadcast(MetaTraining(poles), (1,)), keys(1), META_TRAINING, 100),
        "Algorithm 1 on maps": lambda: (
            broadcast(MetaTraining(obstacle_maps("train"), for_grid_games()), (1,)),
            keys(1),
            META_TRAINING,
            5,
        ),
        "DQN": lambda: (DQN(poles, tasks, shaping()), keys(count), DQN_PHASES, 100),
        "DDPG": lambda: (DDPG(cartpoles(continuous=True), tasks, shaping()), keys(count), DDPG_PHASES, 50),
        "adaptation": lambda: (adaptation(), keys(count), ADAPTATION_PHASES, 5),
    }


def cut_off(learners: AbstractLearner, keys: Keys, phases: Mapping[str, Phase], steps: int) -> dict[str, Part]:
    """Programs of a number of steps that end after each phase."""
    axes = jax.tree.map(lambda leaf: 0 if np.ndim(leaf) else None, learners)
    alone = learners.takes_turns
    start = jax.jit(jax.vmap(lambda one, key: one.init(key), (axes, 0)), compiler_options=QUICK_TO_COMPILE)
    states = start(learners, keys)

    def of(phase: Phase) -> Part:
        def run(learner: AbstractLearner, state: Any) -> tuple[Any, Any]:
            def body(_: Any, carry: tuple[Any, Any]) -> tuple[Any, Any]:
                state, number = phase(learner, carry[0])
                return state, carry[1] + number

            return jax.lax.fori_loop(0, steps, body, (state, jnp.zeros(())))

        # Convolutional learners run without an axis of learners, one after the other.
        mapped = run if alone else jax.vmap(run, (axes, 0))
        program = jax.jit(mapped, donate_argnums=1, compiler_options=QUICK_TO_RUN)
        given = (learners, states)
        if alone:
            given = jax.tree.map(lambda leaf: leaf[0] if np.ndim(leaf) else leaf, given)
        held = [jax.tree.map(jnp.copy, given[1])]

        def go() -> None:
            held[0], _ = jax.block_until_ready(program(given[0], held[0]))

        return Part(go)

    return {name: of(phase) for name, phase in phases.items()}


def differences(rows: dict[str, Row], counts: dict[str, int]) -> dict[str, Row]:
    """Milliseconds of a step, up to each phase and in it, and its share of the whole."""
    last = {name.split(": ")[0]: row["median"] for name, row in rows.items()}
    before: dict[str, float] = {}
    for name, row in rows.items():
        job, milliseconds = name.split(": ")[0], 1e3 / counts[name]
        row["seconds"] = [milliseconds * seconds for seconds in row["seconds"]]
        own = row["median"] - before.get(job, 0.0)
        before[job] = row["median"]
        row |= harness.spread(row["seconds"]) | {"ms in it": milliseconds * own, "share, %": 100 * own / last[job]}
    return rows


if __name__ == "__main__":
    main(tyro.cli(Options))
