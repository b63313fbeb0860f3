"""Peak resident memory as tasks, seeds, replay and inner steps grow; full graph, first order, and rematerialised.

``python -m benchmarks.memory`` writes ``benchmarks/results/memory.json``. Each case runs in its own process; what a
process holds before it does anything, its imports, is taken off. The peak is that of a step after the first one, which
compiles and takes more; where the system can't start a new peak (it can on Linux) the two are one.
"""

import ctypes
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks import harness
from benchmarks.going import Going
from benchmarks.harness import Row
from upslope.learners.dqn import DQN, DQNConfig
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.meta_training.posteriors.network import TaskBatch
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast
from upslope.tasks import cartpoles

ROOT = Path(__file__).parents[1]

#: Ways to take the meta-gradient of inner steps: with a stopped target of Eq. 7, and three with a kept one.
DEFAULT = "stopped target (the default)"
GRADIENTS = (DEFAULT, "full", "first order", "rematerialised")


@dataclass(frozen=True)
class Options(harness.Options):
    """What to measure.

    Attributes:
        repeats: processes of each case, in turns.
        tasks: of one meta-iteration on CartPole.
        seeds: meta-trained together.
        replays: transitions that each of ten DQN learners remembers.
        inner_steps: N of the convolutional meta-gradient.
        case: of one process; set by the benchmark itself.
    """

    repeats: int = 5
    tasks: tuple[int, ...] = (10, 100, 1000)
    seeds: tuple[int, ...] = (1, 10, 100)
    replays: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    inner_steps: tuple[int, ...] = (1, 3, 10)
    case: str = ""


@dataclass(frozen=True)
class Case:
    """One process.

    Attributes:
        kind: "tasks", "seeds", "replay", or how the meta-gradient of inner steps is taken, one of `GRADIENTS`.
        size: how many.
    """

    kind: str
    size: int


def main(options: Options) -> None:
    """Starts a process for each case."""
    if options.quick:
        options = replace(options, repeats=1, tasks=(2,), seeds=(2,), replays=(1000,), inner_steps=(1,))
    cases = [Case("tasks", n) for n in options.tasks] + [Case("seeds", n) for n in options.seeds]
    cases += [Case("replay", n) for n in options.replays]
    cases += [Case(how, n) for how in GRADIENTS for n in options.inner_steps]
    rows: dict[str, Row] = {}
    turns = [[measured(case) for case in cases] for _ in range(options.repeats)]
    for case, found in zip(cases, zip(*turns, strict=True), strict=True):
        with_compiling = {"MiB with compiling": float(np.median([each["with_compiling"] for each in found]))}
        rows[label(case)] = harness.spread([each["mebibytes"] for each in found]) | with_compiling
    harness.write("memory", options, rows, unit="MiB over the imports")


def label(case: Case) -> str:
    """In words."""
    if case.kind in ("tasks", "seeds"):
        return f"Algorithm 1 on CartPole, {case.size:,} {case.kind}"
    if case.kind == "replay":
        return f"10 DQN learners, replay of {case.size:,}"
    return f"convolutional meta-gradient of 10 tasks, N = {case.size}, {case.kind}"


def measured(case: Case) -> dict[str, float]:
    """What the process of a case says of itself."""
    command = [sys.executable, "-m", "benchmarks.memory", "--case", json.dumps(asdict(case))]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{label(case)} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def alone(case: Case) -> None:
    """Does the work of one case, twice, and prints the peak of both times and of the second.

    What compiling leaves behind counts too, so every process compiles: none finds what another one has kept.
    """
    set_up_devices(harness.scratch())
    jax.block_until_ready(jnp.zeros(1))
    before = peak()
    work = prepared(case)
    work()
    with_compiling = peak()
    start_new_peak()
    work()
    print(json.dumps({"mebibytes": peak() - before, "with_compiling": with_compiling - before}))


def peak() -> float:
    """Largest resident set of this process, in MiB: so far, or since `start_new_peak`."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 2**10
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (2**20 if sys.platform == "darwin" else 2**10)


def start_new_peak() -> None:
    """Gives freed memory back, and forgets the largest resident set; does nothing where that can't be done."""
    if not sys.platform.startswith("linux"):
        return
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")


def prepared(case: Case) -> Callable[[], Any]:
    """The work of a case."""
    small = MetaTrainingConfig(evaluation_tasks=1, evaluation_episodes=1)
    if case.kind == "tasks":
        return going(MetaTraining(cartpoles(), replace(small, tasks=case.size)), 1)
    if case.kind == "seeds":
        return going(MetaTraining(cartpoles(), small), case.size)
    if case.kind == "replay":
        family = cartpoles()
        tasks = family.sample_many(jax.random.key(1), 10)
        learners = DQN(family, tasks, None, DQNConfig(replay_capacity=case.size, evaluation_episodes=1))
        started = Going(learners, jax.random.split(jax.random.key(0), 10))
        return lambda: started.advance(1)
    return meta_gradient(case)


def going(learner: MetaTraining, seeds: int) -> Callable[[], None]:
    """One meta-iteration."""
    started = Going(broadcast(learner, (seeds,)), jax.random.split(jax.random.key(0), seeds))
    return lambda: started.advance(1)


def meta_gradient(case: Case) -> Callable[[], Any]:
    """The gradient of Eq. 7 on both sides, with convolutions, one task after the other."""
    from benchmarks.convolutional_step import Sizes, network, outer_gradient, transitions

    gradient = outer_gradient(
        "stopped" if case.kind == DEFAULT else "kept",
        inner_steps=case.size,
        first_order=case.kind == "first order",
        rematerialise=case.kind == "rematerialised",
    )
    theta, samples = network("patches"), TaskBatch(transitions(Sizes()), None)
    step = jax.jit(lambda theta: gradient(theta, samples))
    return lambda: jax.block_until_ready(step(theta))


if __name__ == "__main__":
    chosen = tyro.cli(Options)
    if chosen.case:
        alone(Case(**json.loads(chosen.case)))
    else:
        main(chosen)
