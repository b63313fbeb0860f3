"""Learning curves of each implementation of Algorithm 1: mean greedy returns on poles."""

import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from benchmarks.going import Going
from benchmarks.harness import Bar
from benchmarks.peers.numpy_cartpoles import greedy_returns, numpy_advantages, weights_of
from upslope.meta_training.algorithm1 import MetaTraining
from upslope.meta_training.config import MetaTrainingConfig
from upslope.run.loop import broadcast
from upslope.tasks import cartpoles

#: Poles, the same for all, on which what was learned is tried; between them they cover the family.
LENGTHS = np.linspace(0.25, 5.0, 40)


def learned(iterations: int, every: int, seeds: tuple[int, int, int], threads: int) -> dict[str, Any]:
    """Returns of each seed's averaged θ in the course of shortened runs.

    Args:
        iterations: of each run.
        every: iterations between the points of the curves.
        seeds: of upslope, of the careful peer and of the plain one.
        threads: of PyTorch's.

    Returns:
        By who: "returns" at the end, and "mean at N" for each point of the curve.
    """
    config = replace(MetaTrainingConfig(), iterations=iterations)
    own, careful, plain = seeds
    curves = {"upslope": list(ours(config, own, every))}
    if importlib.util.find_spec("torch") is not None:
        import torch

        from benchmarks.peers.careful_meta_training import CarefulMetaTraining
        from benchmarks.peers.plain_meta_training import PlainMetaTraining

        torch.set_num_threads(threads)
        for name, kind, count in (
            ("PyTorch, careful", CarefulMetaTraining, careful),
            ("PyTorch, plain", PlainMetaTraining, plain),
        ):
            # Transposed: for each point of the curve, the returns of all seeds.
            curves[name] = list(zip(*(peer(kind(config, seed), every) for seed in range(count)), strict=True))
    points = range(every, iterations + 1, every)
    return {
        name: {f"mean at {point}": float(np.mean(values)) for point, values in zip(points, curve, strict=True)}
        | {"returns": list(curve[-1])}
        for name, curve in curves.items()
    }


def ours(config: MetaTrainingConfig, seeds: int, every: int) -> Iterator[list[float]]:
    """Returns of all seeds, at each point."""
    going = Going(broadcast(MetaTraining(cartpoles(), config), (seeds,)), jax.random.split(jax.random.key(0), seeds))
    for _ in range(config.iterations // every):
        going.advance(every)
        averages = jax.tree.map(np.asarray, going.states.average)
        each = [jax.tree.map(lambda leaf, seed=seed: leaf[seed], averages) for seed in range(seeds)]
        yield [return_of(weights_of(average)) for average in each]


def peer(one: Any, every: int) -> Iterator[float]:
    """The return of one seed of a peer's, at each point."""
    for _ in range(one.config.iterations // every):
        one.iterate(every)
        yield return_of({name: weight.detach().numpy() for name, weight in one.average.named_parameters()})


def return_of(weights: dict[str, np.ndarray]) -> float:
    """Mean return of one greedy episode on each pole."""
    return float(np.mean(greedy_returns(numpy_advantages(weights), LENGTHS)))


def bars(curves: dict[str, Any]) -> list[Bar]:
    """That all learn alike."""
    found = []
    for name, curve in curves.items():
        if name != "upslope":
            gap = standard_errors_apart(curves["upslope"]["returns"], curve["returns"])
            seeds = f"{len(curves['upslope']['returns'])} and {len(curve['returns'])} seeds"
            what = f"{name} learns the same: means of shortened runs at most 3 standard errors apart ({seeds})"
            found.append(Bar(what, gap, 3, at_most=True))
    return found


def standard_errors_apart(ours: list[float], theirs: list[float]) -> float | None:
    """The distance of two means in standard errors of their difference; our spread stands in for few values."""
    if len(ours) < 2:
        return None
    spread = np.var(ours, ddof=1)
    other = np.var(theirs, ddof=1) if len(theirs) > 4 else spread
    error = np.sqrt(spread / len(ours) + other / len(theirs))
    return float(abs(np.mean(ours) - np.mean(theirs)) / max(error, 1e-9))
