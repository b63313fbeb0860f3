"""A process to be killed: one small run with frequent checkpoints, which prints a digest of where it ended.

``python -m reliability.worker KIND FOLDER [--resume] [--at PHASE --deed KILL|TERM --delay SECONDS --nth N]`` sends
itself a signal in the N-th pass of a phase, some time after its beginning.
"""

import hashlib
import itertools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium
import jax
import tyro

from upslope import storage
from upslope.api import adapt, meta_train, train
from upslope.envs.cartpole import CartPole
from upslope.errors import InterruptedRunError
from upslope.meta_training.config import MetaTrainingConfig
from upslope.networks.dueling import DuelingQ
from upslope.priors.prior import Prior, trained_on
from upslope.run.checkpoints import FORMAT_VERSION, KIND, Checkpoints
from upslope.run.compiling import set_up_devices
from upslope.run.engines import CompiledEngine
from upslope.run.folder import claim
from upslope.run.observers import EventLog
from upslope.run.session import Session
from upslope.run.signals import stop_requests
from upslope.tasks import GymnasiumTasks, cartpoles

KINDS = ("meta-training", "dqn", "ddpg", "adaptation")
#: On Gymnasium environments, which start new episodes after a stop, so these runs do not end at the same bits.
HOST_KINDS = ("host-meta-training", "host-dqn")
PHASES = ("starting", "compiling", "evaluating", "running", "saving", "ending")
FEW = {"tasks": 4, "steps_per_task": 50, "evaluation_tasks": 2, "evaluation_episodes": 1}
POLES, FORCES = cartpoles(), cartpoles(continuous=True)


@dataclass(frozen=True)
class Worker:
    """What to run, and what to do to itself."""

    kind: tyro.conf.Positional[Literal["meta-training", "dqn", "ddpg", "adaptation", "host-meta-training", "host-dqn"]]
    folder: tyro.conf.Positional[Path]
    resume: bool = False
    at: str | None = None
    deed: Literal["KILL", "TERM"] = "KILL"
    delay: float = 0.0
    nth: int = 1


def learn(kind: str, session: Session) -> None:
    """Some seconds of learning once it is compiled."""
    task = POLES.sample(jax.random.key(0))
    if kind == "meta-training":
        meta_train(POLES, config=MetaTrainingConfig(iterations=400, snapshot_every=40), session=session)
    elif kind == "adaptation":
        network = DuelingQ(jax.random.key(1), 4, 2)
        adapt(POLES, task, Prior(network, trained_on(POLES, network, 0, {})), updates=400, session=session)
    elif kind == "host-meta-training":
        meta_train(host_poles(), config=MetaTrainingConfig(iterations=15, snapshot_every=1, **FEW), session=session)
    elif kind == "host-dqn":
        train(host_poles(), host_poles().sample(jax.random.key(0)), updates=400, every=40, session=session)
    elif kind == "dqn":
        train(POLES, task, updates=15000, every=1000, session=session)
    else:
        train(FORCES, FORCES.sample(jax.random.key(0)), updates=10000, every=500, session=session)


def host_poles() -> GymnasiumTasks:
    """CartPoles of any length on the host."""
    return GymnasiumTasks(
        lambda generator: float(generator.uniform(0.25, 5.0)),
        lambda length: gymnasium.make("upslope/CartPole-v0", length=length),
        0.98,
        name="cartpole",
        observation_scale=CartPole.observation_scale,
    )


def digest(folder: Path, kind: str) -> str:
    """SHA-256 of the final state, reports and metrics, and of the logged steps, but not of the times of all that.

    Of runs on the host only of the logged steps, and that the last checkpoint is whole.
    """
    newest = max((folder / "checkpoints").rglob("*.safetensors"))
    checksums = storage.read(newest, KIND, FORMAT_VERSION).checksums
    for clock in ("times", "seconds", "elapsed"):
        del checksums[clock]
    whole = hashlib.sha256(b"" if kind in HOST_KINDS else storage.content_digest(checksums).encode())
    for line in next((folder / "logs").rglob("metrics.jsonl")).read_text().splitlines():
        whole.update(line.split('"update"')[1].split(",")[0].encode())  # neither gaps nor duplicates
    return whole.hexdigest()


def sabotage(options: Worker) -> None:
    """Wraps what marks the beginning of the phase."""
    counter = itertools.count(1)

    def reached() -> None:
        if next(counter) == options.nth:
            if options.delay:
                threading.Timer(options.delay, do).start()
            else:
                do()

    def do() -> None:
        os.write(2, f"signalled at {time.time()}\n".encode())
        os.kill(os.getpid(), getattr(signal, f"SIG{options.deed}"))

    def before(module: Any, name: str, when: Callable[..., bool] = lambda *_, **__: True) -> None:
        inner = getattr(module, name)

        def wrapped(*args: Any, **kwargs: Any) -> Any:
            if when(*args, **kwargs):
                reached()
            return inner(*args, **kwargs)

        setattr(module, name, wrapped)

    if options.at == "starting":
        before(Checkpoints, "stage")
    elif options.at == "compiling":
        before(CompiledEngine, "start")
    elif options.at == "evaluating":
        before(CompiledEngine, "advance", lambda *_, report, **__: report)
    elif options.at == "running":
        before(CompiledEngine, "advance", lambda *_, report, **__: not report)
    elif options.at == "saving":
        before(storage, "write")
    elif options.at == "ending":
        before(EventLog, "end")
    elif options.at is not None:
        before(storage, "milestone", lambda name: name == options.at)


def main() -> None:
    """Runs it."""
    options = tyro.cli(Worker)
    set_up_devices()
    sabotage(options)
    try:
        with stop_requests(), claim(options.folder, options.kind, resume=options.resume) as folder:
            kept = Checkpoints(folder, every_seconds=0.2, resume=options.resume)
            learn(options.kind, Session([EventLog(folder / "logs")], kept))
    except InterruptedRunError as stop:
        sys.exit(128 + stop.signal)
    print(digest(options.folder, options.kind), flush=True)


if __name__ == "__main__":
    main()
