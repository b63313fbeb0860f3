"""Two cores against one: learners spread over a device for each core, against one device, one core, and two processes.

And one learner alone, whose tasks two devices could share.

``python -m benchmarks.devices`` writes ``benchmarks/results/devices.json``. Each way is a process that waits for its
turn, so that all share the same minutes.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import tyro

from benchmarks import harness
from benchmarks.going import Going
from benchmarks.harness import Bar, Part, Row
from upslope.learners.dqn import DQN, DQNConfig
from upslope.learners.sharing import most_devices
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.compiling import set_up_devices
from upslope.run.loop import broadcast
from upslope.tasks import cartpoles

ROOT = Path(__file__).parents[1]
SHARED = "Algorithm 1, tasks shared"
JOBS = {"DQN": "DQN learners", "Algorithm 1": "seeds of Algorithm 1"}


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        learners: DQNs trained together; divided between the processes where there are two.
        updates: of them in a repeat.
        seeds: of Algorithm 1.
        iterations: of it.
        worker: the job of a process, its learners, steps and devices; set by the benchmark itself.
    """

    learners: int = 200
    updates: int = 300
    seeds: int = 10
    iterations: int = 30
    worker: tuple[str, ...] = ()


def main(options: Options) -> None:
    """Lets the processes work in turns."""
    if options.quick:
        options = replace(options, repeats=1, learners=4, updates=5, seeds=2, iterations=2)
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    if len(cores) < 2:
        raise SystemExit(
            "This compares two cores with one, but the process may use only one, or the system does not report it."
        )
    first, both = cores[:1], cores[:2]
    parts: dict[str, Part] = {}
    workers: list[Worker] = []
    for job, count, steps in (
        ("DQN", options.learners, options.updates),
        ("Algorithm 1", options.seeds, options.iterations),
    ):
        ways = {
            "one core": [Worker(job, count, steps, first, 1)],
            "two cores, one device": [Worker(job, count, steps, both, 1)],
            "two cores, a device each (what upslope does)": [Worker(job, count, steps, both, 2)],
            "two processes of half as many": [Worker(job, count // 2, steps, [core], 1) for core in both],
        }
        for way, crew in ways.items():
            parts[f"{count} {JOBS[job]}: {way}"] = Part(lambda crew=crew: work(crew), {"learner-steps": count * steps})
            workers += crew
    for way, job in (("one device (what upslope does)", "Algorithm 1"), ("its tasks shared by a device each", SHARED)):
        crew = [Worker(job, 1, options.iterations, both, 2)]
        parts[f"one seed of Algorithm 1: two cores, {way}"] = Part(
            lambda crew=crew: work(crew), {"learner-steps": options.iterations}
        )
        workers += crew
    try:
        rows = harness.time_in_turns(parts, options.repeats)
    finally:
        for worker in workers:
            worker.end()
    for row in rows.values():
        del row["compiling"], row["programs"]  # of this process, which compiles nothing
    harness.write("devices", options, rows, bars=bars(rows))


class Worker:
    """A process on some cores that does its job on request."""

    def __init__(self, job: str, count: int, steps: int, cores: Sequence[int], devices: int):
        arguments = (job, str(count), str(steps), str(devices))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.devices", "--worker", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        os.sched_setaffinity(self.process.pid, cores)

    def request(self) -> None:
        """Starts a turn."""
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()

    def wait(self) -> None:
        """Until the turn is over."""
        assert self.process.stdout is not None
        if self.process.stdout.readline() != "done\n":
            raise SystemExit("A worker ended before its work was done.")

    def end(self) -> None:
        """Lets it go."""
        self.process.communicate()


def work(crew: Sequence[Worker]) -> None:
    """All of a crew at once, waited for."""
    for worker in crew:
        worker.request()
    for worker in crew:
        worker.wait()


def worker(job: str, count: str, steps: str, devices: str) -> None:
    """The process' side: a turn for each line."""
    going: Going | None = None
    for _ in sys.stdin:
        if going is None:
            set_up_devices()
            jax.config.update("jax_num_cpu_devices", int(devices))
            going = started(job, int(count))
        going.advance(int(steps))
        print("done", flush=True)


def started(job: str, count: int) -> Going:
    """The learners of a job."""
    keys = jax.random.split(jax.random.key(0), count)
    if job == "DQN":
        tasks = cartpoles().sample_many(jax.random.key(1), count)
        return Going(DQN(cartpoles(), tasks, None, DQNConfig(evaluation_episodes=1)), keys)
    if job == SHARED:
        MetaTraining.most_devices = lambda self, devices: most_devices(self.config.tasks, devices)  # type: ignore[method-assign]
    config = MetaTrainingConfig(evaluation_tasks=1, evaluation_episodes=1)
    return Going(broadcast(MetaTraining(cartpoles(), config), (count,)), keys)


def bars(rows: dict[str, Row]) -> list[Bar]:
    """Two cores used well: at least half again as fast as one."""
    found = []
    for job in JOBS.values():
        named = {name.split(": ")[1]: row["median"] for name, row in rows.items() if job in name}
        gain = named["one core"] / named["two cores, a device each (what upslope does)"]
        best = named["one core"] / named["two processes of half as many"]
        bound = f"the cores share memory and caches: two independent processes gain {best:.2f}"
        found.append(Bar(f"{job}: two cores at least 1.5 × as fast as one", gain, 1.5, bound=bound))
    return found


if __name__ == "__main__":
    chosen = tyro.cli(Options)
    if chosen.worker:
        worker(*chosen.worker)
    else:
        main(chosen)
