"""Runs a wrapped environment and records what every layer of wrappers does to the reward.

Some episodes are made to end early at the innermost environment: random actions alone seldom lead to a truncation.
"""

from typing import Any, NamedTuple

import numpy as np

from upslope.checking.innermost import AbstractInnermost, innermost_of
from upslope.checking.layers import AbstractLayer, layers_of
from upslope.checking.watching import watch


class Recording(NamedTuple):
    """What was recorded.

    Attributes:
        layers: from the innermost environment to the outermost wrapper.
        innermost: what is known about the innermost environment.
        trouble: the error that ended the run early, if any.
    """

    layers: list[AbstractLayer]
    innermost: AbstractInnermost
    trouble: Exception | None


def record(env: Any, steps: int, seed: int) -> Recording:
    """Takes this number of steps with random actions.

    Raises:
        UpslopeError: not a Gymnasium environment.
    """
    layers = layers_of(env)
    innermost = innermost_of(layers[0].env)
    trouble = None
    with watch(layers, innermost, seed, steps):
        try:
            _run(layers, steps, seed)
        except Exception as error:
            trouble = error
    return Recording(layers, innermost, trouble)


def _run(layers: list[AbstractLayer], steps: int, seed: int) -> None:
    env = layers[-1].env
    env.action_space.seed(seed)
    env.reset(seed=seed)
    resets_itself = any(layer.resets_itself for layer in layers)
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        done = np.logical_or(terminated, truncated)
        if not resets_itself and np.any(done):
            layers[-1].reset_done(done)
