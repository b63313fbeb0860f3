"""The engine for environments in JAX: one compiled program per chunk, over all learners and the local devices."""

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Bool, Int

from upslope.compiler_options import ONE_THREAD, PATIENT, QUICK_TO_COMPILE, QUICK_TO_RUN
from upslope.learners.learner import AbstractLearner
from upslope.run.engines.engine import AbstractEngine, Chunk
from upslope.run.health import all_finite
from upslope.types import Key, Keys, Metrics

_AXIS, _SHARED = "learners", "tasks"

#: Bounds of `block_size`.
_SMALLEST, _LARGEST = 8, 16


class CompiledEngine(AbstractEngine):
    """Takes all steps of a chunk in one program, mapped over the learners and spread over the local devices.

    The number of steps is an input of the program, and so is whether to report: chunks of any length share one program.
    """

    restores_episodes: ClassVar[bool] = True

    def device_count(self, learners: int) -> int:
        """Leaves out devices that would only work on padding."""
        share = math.ceil(learners / len(jax.local_devices()))
        return math.ceil(learners / share)

    def mesh(self, learners: AbstractLearner, count: int) -> Mesh:
        """The mesh ``[learners, tasks]`` of local devices for ``count`` learners.

        If there are more devices than learners, several share the work of each learner, where that pays.
        """
        own = self.device_count(count)
        sharing = learners.most_devices(len(jax.local_devices()) // own)
        return Mesh(np.asarray(jax.local_devices()[: own * sharing]).reshape(own, sharing), (_AXIS, _SHARED))

    def spread(self, learners: AbstractLearner, batch: Any) -> Any:
        mesh = self.mesh(learners, _length(batch))

        def place(leaf: Any) -> jax.Array:
            return jax.device_put(leaf, NamedSharding(mesh, P(_AXIS) if jnp.ndim(leaf) else P()))

        return jax.tree.map(place, batch)

    def compile(self, learners: AbstractLearner, keys: Keys) -> None:
        mesh = self.mesh(learners, keys.shape[0])
        started = _start_program(learners).lower(learners, keys, mesh).compile()

        def describe(info: Any, sharding: Any) -> jax.ShapeDtypeStruct:
            return jax.ShapeDtypeStruct(info.shape, info.dtype, sharding=sharding)

        states, totals = jax.tree.map(describe, started.out_info, started.output_shardings)
        settings = (np.int32(0), np.bool_(False), np.bool_(False))
        _advance_program(mesh).lower(learners, states, totals, *settings, mesh).compile()

    def start(self, learners: AbstractLearner, keys: Keys) -> tuple[Any, Metrics]:
        return _start_program(learners)(learners, keys, self.mesh(learners, keys.shape[0]))

    def advance(
        self, learners: AbstractLearner, states: Any, totals: Metrics, steps: int, *, fresh: bool, report: bool
    ) -> Chunk:
        mesh = self.mesh(learners, _length(totals))
        settings = (np.int32(steps), np.bool_(fresh), np.bool_(report))
        return _advance_program(mesh)(learners, states, totals, *settings, mesh)

    def shapes(self, learners: AbstractLearner, keys: Keys) -> tuple[Any, Any, Any]:
        states, totals = jax.eval_shape(jax.vmap(_start_one, in_axes=(_axes(learners), 0)), learners, keys)
        return states, totals, jax.eval_shape(jax.vmap(_report_one, in_axes=(_axes(learners), 0)), learners, states)

    def close(self, learners: AbstractLearner) -> None:
        """Does nothing: nothing is open."""


def block_size(learners: AbstractLearner, count: int) -> int:
    """The number of a device's ``count`` learners that take all steps of a chunk side by side; it divides ``count``.

    On CPUs what about ten learners compute in a step stays in a core's own cache. With a hundred it does not, and the
    cores get in each other's way. With fewer, starting the kernels costs most. One convolutional learner fills the
    cache alone. Other devices take all learners at once.
    """
    if learners.takes_turns:
        return 1
    if jax.default_backend() != "cpu":
        return count
    return max((size for size in range(_SMALLEST, _LARGEST + 1) if count % size == 0), default=count)


def _start_one(learner: AbstractLearner, key: Key) -> tuple[Any, Metrics]:
    state = learner.init(key)
    return state, _zeros(jax.eval_shape(learner.step, state)[1])


def _report_one(learner: AbstractLearner, state: Any) -> dict[str, Any]:
    return learner.report(state)


def _advance_one(
    learner: AbstractLearner,
    state: Any,
    totals: Metrics,
    steps: Int[Array, ""],
    fresh: Bool[Array, ""],
    report: Bool[Array, ""],
) -> Chunk:
    def body(index: Int[Array, ""], carry: tuple[Any, Metrics, Int[Array, ""]]) -> tuple[Any, Metrics, Int[Array, ""]]:
        state, totals, broken = carry
        state, metrics = learner.step(state)
        broken = jnp.where((broken == 0) & ~all_finite(metrics), index + 1, broken)
        return state, jax.tree.map(jnp.add, totals, metrics), broken

    totals = jax.tree.map(lambda leaf: jnp.where(fresh, jnp.zeros_like(leaf), leaf), totals)
    state, totals, broken = jax.lax.fori_loop(0, steps, body, (state, totals, jnp.zeros((), jnp.int32)))
    reported = jax.lax.cond(
        report, lambda: learner.report(state), lambda: _zeros(jax.eval_shape(learner.report, state))
    )
    return Chunk(state, totals, broken, reported)


def _zeros(shapes: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


def _axes(inputs: Any) -> Any:
    """The learners' axis of every leaf; 0-d leaves are shared by all learners."""
    return jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, inputs)


def _length(batch: Any) -> int:
    """The number of learners in a stacked PyTree ``[learners, ...]``."""
    return next(leaf.shape[0] for leaf in jax.tree.leaves(batch) if jnp.ndim(leaf))


def _map_over(function: Any, mesh: Mesh, learners: AbstractLearner, *others: Any) -> Any:
    """Applies a function of stacks ``[learners, ...]`` on each device to its own share of the learners."""
    inputs = (learners.over(_SHARED) if mesh.shape[_SHARED] > 1 else learners, *others)
    specs = jax.tree.map(lambda leaf: P(_AXIS) if jnp.ndim(leaf) else P(), inputs)
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=P(_AXIS), check_vma=False)(*inputs)


def _start_stack(learners: AbstractLearner, keys: Keys) -> tuple[Any, Metrics]:
    return jax.vmap(_start_one, in_axes=(_axes(learners), 0))(learners, keys)


def _advance_stack(learners: AbstractLearner, states: Any, totals: Metrics, *settings: Array) -> Chunk:
    """A device's share of the learners, in blocks of `block_size`, one after the other."""
    count = jax.tree.leaves(totals)[0].shape[0]
    size = block_size(learners, count)
    side_by_side = jax.vmap(_advance_one, in_axes=(_axes(learners), 0, 0, None, None, None))
    advance = _advance_alone if learners.takes_turns else side_by_side
    if size == count:
        return advance(learners, states, totals, *settings)

    def one_block(block: Int[Array, ""], chunk: Chunk) -> Chunk:
        def take(leaf: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(leaf, block * size, size)

        def put(old: Array, new: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(old, new, block * size, 0)

        own = jax.tree.map(lambda leaf: take(leaf) if jnp.ndim(leaf) else leaf, learners)
        # In place, without a second copy of all the replays.
        return jax.tree.map(put, chunk, advance(own, *jax.tree.map(take, (chunk.states, chunk.totals)), *settings))

    shapes = jax.eval_shape(side_by_side, learners, states, totals, *settings)
    start = Chunk(states, totals, *_zeros((shapes.broken, shapes.report)))
    return jax.lax.fori_loop(0, count // size, one_block, start)


def _advance_alone(learners: AbstractLearner, states: Any, totals: Metrics, *settings: Array) -> Chunk:
    """A stack of one learner, without the axis of the stack, so that no convolution is batched over it."""
    one = jax.tree.map(lambda leaf: leaf[0] if jnp.ndim(leaf) else leaf, (learners, states, totals))
    return jax.tree.map(lambda leaf: leaf[None], _advance_one(*one, *settings))


def _start_all(learners: AbstractLearner, keys: Keys, mesh: Mesh) -> tuple[Any, Metrics]:
    return _map_over(_start_stack, mesh, learners, keys)


def _advance_all(
    learners: AbstractLearner,
    states: Any,
    totals: Metrics,
    steps: Int[Array, ""],
    fresh: Bool[Array, ""],
    report: Bool[Array, ""],
    mesh: Mesh,
) -> Chunk:
    return _map_over(_advance_stack, mesh, learners, states, totals, steps, fresh, report)


# A program that runs once compiles as fast as possible, one that runs for long is optimised. So are
# starts of learners that take turns, because their networks are large.
_start_once, _start_in_turns = (
    jax.jit(_start_all, static_argnames="mesh", compiler_options=options)
    for options in (QUICK_TO_COMPILE, QUICK_TO_RUN)
)
_advance_on_one, _advance_on_many = (
    jax.jit(_advance_all, static_argnames="mesh", donate_argnames=("states", "totals"), compiler_options=options)
    for options in (QUICK_TO_RUN, QUICK_TO_RUN | ONE_THREAD | PATIENT)
)


def _start_program(learners: AbstractLearner) -> Any:
    return _start_in_turns if learners.takes_turns else _start_once


def _advance_program(mesh: Mesh) -> Any:
    return _advance_on_many if mesh.size > 1 else _advance_on_one
