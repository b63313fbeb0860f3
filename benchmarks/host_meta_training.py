"""Where the time goes when Algorithm 1 trains on Gymnasium environments.

``python -m benchmarks.host_meta_training`` writes ``benchmarks/results/host_meta_training.json``.
"""

import time
from dataclasses import dataclass

import gymnasium as gym
import jax
import numpy as np
import tyro

from benchmarks import harness
from benchmarks.harness import Bar
from upslope import GymnasiumTasks, MetaTrainingConfig
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.run.loop import broadcast, run

#: Gymnasium's own CartPole, and ours with the same physics, whose step costs a third of it.
NAMES = ("CartPole-v1", "upslope/CartPole-v0")

_ACTING = "choosing actions in NumPy and recording transitions, 3 ms an iteration; drawing and launching, 2 ms"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        iterations: meta-iterations of a run, of 10 tasks × 200 steps each; 500 are the default of a meta-training.
    """

    iterations: int = 500


def main(options: Options) -> None:
    """Times the runs in turns, and writes the share of the time that was spent in the environments."""
    iterations, repeats = (2, 1) if options.quick else (options.iterations, options.repeats)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in NAMES}
    for repeat in range(repeats + 1):
        for name in NAMES:
            timed = train(name, iterations)
            if repeat:
                found[name].append(timed)
    rows = {}
    for name, timed in found.items():
        seconds, shares = zip(*timed, strict=True)
        rows[f"{iterations} iterations on {name}"] = harness.spread(seconds) | {
            "seconds": list(seconds),
            "share in environments": float(np.median(shares)),
        }
    share = rows[f"{iterations} iterations on {NAMES[0]}"]["share in environments"]
    bar = Bar("At least 80 % of the time within Gymnasium's CartPoles", share, 0.8, bound=_ACTING)
    harness.write("host_meta_training", options, rows, bars=[bar])


def train(name: str, iterations: int) -> tuple[float, float]:
    """Seconds of a run without compiling and without its reports, and the share of them inside environments."""
    family = GymnasiumTasks(lambda rng: float(rng.uniform(0.25, 5.0)), lambda length: made(name, length), 0.98)
    config = MetaTrainingConfig(evaluation_tasks=1, evaluation_episodes=1)
    learners = broadcast(MetaTraining(family, config), (1,))
    began = time.perf_counter()
    outcome = run(learners, jax.random.key(0)[None], updates=iterations, every=iterations)
    seconds = time.perf_counter() - began - outcome.seconds_compiling
    return seconds, family.rollouts.seconds / seconds


def made(name: str, length: float) -> gym.Env:
    """A CartPole of this full length, with everything that follows from the length."""
    if name.startswith("upslope"):
        return gym.make(name, length=length)
    env = gym.make(name, max_episode_steps=200)
    pole = env.unwrapped
    pole.length, pole.masspole = length / 2, 0.1 * length  # type: ignore[attr-defined]
    pole.total_mass = pole.masscart + pole.masspole  # type: ignore[attr-defined]
    pole.polemass_length = pole.masspole * pole.length  # type: ignore[attr-defined]
    return env


if __name__ == "__main__":
    main(tyro.cli(Options))
