"""What shaping costs a simulator process at every step, beside the bare environment.

``python -m benchmarks.wrapper`` writes ``benchmarks/results/wrapper.json``.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import jax
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import upslope
from upslope.meta_training import MetaTraining
from upslope.prior import trained_on
from upslope.run.machine import hardware, versions

RESULTS = Path(__file__).parent / "results" / "wrapper.json"


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 7
    """Of each row, in turns."""
    calls: int = 20_000
    """In each repeat."""


def main(options: Options) -> None:
    """Times every row in turns, and writes microseconds a call."""
    family = upslope.cartpoles()
    network = MetaTraining(family).init(jax.random.key(0)).theta  # the size is what counts
    prior = upslope.Prior(network, trained_on(family, network, 0, {}))
    compiled = jax.jit(lambda obs: network.value(obs))
    rows: dict[str, Callable[[int], float]] = {
        "Φ in numpy, one observation": of_potential(prior.to_numpy()),
        "Φ in JAX, compiled, one observation": of_potential(lambda obs: float(compiled(obs))),
        "bare CartPole-v1": of_environment(gym.make("CartPole-v1")),
        "TransformReward": of_environment(gym.wrappers.TransformReward(gym.make("CartPole-v1"), lambda r: r)),
        "PotentialShaping, a prior": of_environment(shaped(prior)),
        "PotentialShaping, Φ in JAX": of_environment(shaped(lambda obs: compiled(obs))),
        "bare upslope/CartPole-v0": of_environment(gym.make("upslope/CartPole-v0")),
    }
    times: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(options.repeats):
        for name, row in rows.items():
            times[name].append(row(options.calls))
    table = Table("", "microseconds", "range", title="A step on the host")
    for name, values in times.items():
        table.add_row(name, f"{np.median(values):.1f}", f"{min(values):.1f} to {max(values):.1f}")
    content = {"microseconds": times, "calls": options.calls, "versions": versions(), "hardware": hardware()}
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    Console().print(table)
    print(f"Written to {RESULTS}.")


def shaped(potential: object) -> gym.Env:
    """Gymnasium's CartPole, shaped."""
    return upslope.PotentialShaping(gym.make("CartPole-v1"), potential, gamma=0.98)


def of_potential(potential: Callable[[np.ndarray], float]) -> Callable[[int], float]:
    """Microseconds of a call."""
    obs = np.array([0.1, -0.2, 0.05, 0.3], np.float32)
    potential(obs)

    def row(calls: int) -> float:
        began = time.perf_counter()
        for _ in range(calls):
            potential(obs)
        return (time.perf_counter() - began) / calls * 1e6

    return row


def of_environment(env: gym.Env) -> Callable[[int], float]:
    """Microseconds of a step of a policy that balances, its resets counted in."""
    obs, _ = env.reset(seed=0)

    def row(calls: int) -> float:
        nonlocal obs
        began = time.perf_counter()
        for _ in range(calls):
            obs, _, terminated, truncated, _ = env.step(int(obs[2] + 0.3 * obs[3] > 0))
            if terminated or truncated:
                obs, _ = env.reset()
        return (time.perf_counter() - began) / calls * 1e6

    return row


if __name__ == "__main__":
    main(tyro.cli(Options))
