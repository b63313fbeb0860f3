"""Chunks of steps: one compiled program, mapped over a batch of learners and spread over the local devices."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Float, Int

from upslope.learner import AbstractLearner
from upslope.run.compiling import QUICK_TO_COMPILE, QUICK_TO_RUN
from upslope.types import Key, Keys, Metrics

_AXIS = "learners"


def mesh() -> Mesh:
    """All local devices in a row."""
    return Mesh(jax.local_devices(), (_AXIS,))


def spread(batch: Any) -> Any:
    """Lays the leading axis of a stacked PyTree ``[learners, ...]`` over the devices; they must divide it."""
    devices = mesh()

    def place(leaf: Any) -> jax.Array:
        return jax.device_put(leaf, NamedSharding(devices, P(_AXIS) if jnp.ndim(leaf) else P()))

    return jax.tree.map(place, batch)


def start(learners: AbstractLearner, keys: Keys) -> Any:
    """The states ``[learners, ...]`` before the first step."""
    return _start(learners, keys, mesh())


def advance(
    learners: AbstractLearner, states: Any, steps: int
) -> tuple[Any, dict[str, Float[Array, "learners"]], dict[str, Any]]:
    """Takes ``steps`` steps with every learner, then reports.

    The number of steps is an input of the program: chunks of any length, none included, share one program.
    The states given are consumed.

    Returns:
        States, the mean of each metric over the chunk, and the reports, all ``[learners, ...]``.
    """
    return _advance(learners, states, jnp.asarray(steps), mesh())


def _start_one(learner: AbstractLearner, key: Key) -> Any:
    return learner.init(key)


def _advance_one(learner: AbstractLearner, state: Any, steps: Int[Array, ""]) -> tuple[Any, Metrics, dict[str, Any]]:
    shapes = jax.eval_shape(learner.step, state)[1]
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def body(_: Int[Array, ""], carry: tuple[Any, Metrics]) -> tuple[Any, Metrics]:
        state, total = carry
        state, metrics = learner.step(state)
        return state, jax.tree.map(jnp.add, total, metrics)

    state, total = jax.lax.fori_loop(0, steps, body, (state, nothing))
    metrics = jax.tree.map(lambda leaf: leaf / jnp.maximum(steps, 1), total)
    return state, metrics, learner.report(state)


def _mapped(function: Any, devices: Mesh, *inputs: Any) -> Any:
    """The function over the learners' axis of every input; 0-d leaves are shared by all learners."""
    axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, inputs)
    specs = jax.tree.map(lambda leaf: P(_AXIS) if jnp.ndim(leaf) else P(), inputs)
    over_learners = jax.vmap(function, in_axes=axes)
    return jax.shard_map(over_learners, mesh=devices, in_specs=specs, out_specs=P(_AXIS), check_vma=False)(*inputs)


def _start_all(learners: AbstractLearner, keys: Keys, devices: Mesh) -> Any:
    return _mapped(_start_one, devices, learners, keys)


def _advance_all(learners: AbstractLearner, states: Any, steps: Int[Array, ""], devices: Mesh) -> Any:
    return _mapped(_advance_one, devices, learners, states, steps)


# What runs once is compiled as fast as can be; what runs for long, well.
_start = jax.jit(_start_all, static_argnames="devices", compiler_options=QUICK_TO_COMPILE)
_advance = jax.jit(_advance_all, static_argnames="devices", donate_argnames="states", compiler_options=QUICK_TO_RUN)
