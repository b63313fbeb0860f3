"""Watches the layers of a wrapped environment from outside while it runs, without changing what they do."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from upslope.checking.innermost import AbstractInnermost
from upslope.checking.layers import AbstractLayer

#: The rewards that a layer was given in a step, from what the step returned and how many calls the layer below had.
Given = Callable[[tuple, int], Float[np.ndarray, "n"]]


@contextmanager
def watch(layers: list[AbstractLayer], innermost: AbstractInnermost, seed: int, steps: int) -> Iterator[None]:
    """While inside, every reset and step of the layers is recorded, and innermost episodes are made to end."""
    originals: list[tuple[Any, str, Any]] = []

    def patch(target: Any, name: str, function: Callable) -> None:
        originals.append((target, name, vars(target).get(name)))
        setattr(target, name, function)

    try:
        innermost.prepare(patch, seed, max(12, steps // 8), layers[0].calls)
        _record_calls(layers[0], patch, (), lambda result, mark: innermost.raw_rewards(result[1], result[4]))
        for below, layer in pairwise(layers):
            _record_calls(layer, patch, below.calls, _rewards_since(below.calls))
        yield
    finally:
        for target, name, original in originals[::-1]:
            if original is None:
                delattr(target, name)
            else:
                setattr(target, name, original)


def _rewards_since(calls: Sequence[Any]) -> Given:
    # There is more than one call where a wrapper repeats actions.
    return lambda result, mark: sum((call.rewards for call in calls[mark:]), np.zeros(1))


def _record_calls(layer: AbstractLayer, patch: Callable, below: Sequence[Any], given: Given) -> None:
    reset, step = layer.env.reset, layer.env.step

    @wraps(reset)
    def recording_reset(**arguments: Any) -> Any:
        mask = (arguments.get("options") or {}).get("reset_mask")
        mask = None if mask is None else np.array(mask)  # a copy: Gymnasium takes it out of the options
        obs, info = reset(**arguments)
        layer.add_reset(obs, mask)
        return obs, info

    @wraps(step)
    def recording_step(action: Any) -> Any:
        mark = len(below)
        result = step(action)
        layer.add_step(result, given(result, mark))
        return result

    patch(layer.env, "reset", recording_reset)
    patch(layer.env, "step", recording_step)
