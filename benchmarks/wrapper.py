"""The cost of shaping per step in a simulator process, compared with the bare environment and Gymnasium's wrapper.

``python -m benchmarks.wrapper`` writes ``benchmarks/results/wrapper.json``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import jax
import numpy as np
import tyro

import upslope
from benchmarks import harness
from benchmarks.harness import Bar, Part
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.priors.prior import trained_on

PLAIN, SHAPED = "bare CartPole-v1", "PotentialShaping, a prior (numpy)"


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        calls: in each repeat.
    """

    repeats: int = 7
    calls: int = 20_000


def main(options: Options) -> None:
    """Times every row in turns; seconds of a repeat become microseconds of a call."""
    calls = 200 if options.quick else options.calls
    family = upslope.cartpoles()
    network = MetaTraining(family).init(jax.random.key(0)).theta  # the size is what counts
    prior = upslope.Prior(network, trained_on(family, network, 0, {}))
    compiled = jax.jit(lambda obs: network.value(obs))
    callers: dict[str, Callable[[int], None]] = {
        "Φ in numpy, one observation": of_potential(prior.to_numpy()),
        "Φ in JAX, compiled, one observation": of_potential(lambda obs: float(compiled(obs))),
        PLAIN: of_environment(gym.make("CartPole-v1")),
        "TransformReward": of_environment(gym.wrappers.TransformReward(gym.make("CartPole-v1"), lambda r: r)),
        SHAPED: of_environment(shaped(prior)),
        "PotentialShaping, Φ in JAX": of_environment(shaped(lambda obs: compiled(obs))),
        "bare upslope/CartPole-v0": of_environment(gym.make("upslope/CartPole-v0")),
    }
    rows = harness.time_in_turns(
        {name: Part(lambda caller=caller: caller(calls)) for name, caller in callers.items()}, options.repeats
    )
    for row in rows.values():
        row["seconds"] = [1e6 * seconds / calls for seconds in row["seconds"]]
        row |= harness.spread(row["seconds"])
    paired = zip(rows[SHAPED]["seconds"], rows[PLAIN]["seconds"], strict=True)
    added = float(np.median([shaped - plain for shaped, plain in paired]))
    bar = Bar("The wrapper adds at most 10 µs a step on the numpy path", added, 10, at_most=True)
    harness.write("wrapper", options, rows, bars=[bar], unit="µs")


def shaped(potential: object) -> gym.Env:
    """Gymnasium's CartPole, shaped."""
    return upslope.PotentialShaping(gym.make("CartPole-v1"), potential, gamma=0.98)


def of_potential(potential: Callable[[np.ndarray], float]) -> Callable[[int], None]:
    """Calls on one observation."""
    obs = np.array([0.1, -0.2, 0.05, 0.3], np.float32)

    def caller(calls: int) -> None:
        for _ in range(calls):
            potential(obs)

    return caller


def of_environment(env: gym.Env) -> Callable[[int], None]:
    """Steps of a policy that balances, its resets counted in."""
    obs, _ = env.reset(seed=0)

    def caller(calls: int) -> None:
        nonlocal obs
        for _ in range(calls):
            obs, _, terminated, truncated, _ = env.step(int(obs[2] + 0.3 * obs[3] > 0))
            if terminated or truncated:
                obs, _ = env.reset()

    return caller


if __name__ == "__main__":
    main(tyro.cli(Options))
