"""Chunks of steps: one compiled program, mapped over a batch of learners and spread over the local devices."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Bool, Int

from upslope.compiler_options import ONE_THREAD, PATIENT, QUICK_TO_COMPILE, QUICK_TO_RUN
from upslope.learners.learner import AbstractLearner, in_turn
from upslope.types import Key, Keys, Metrics

_AXIS, _SHARED = "learners", "tasks"

#: Bounds of `at_a_time`.
_FEWEST, _MOST = 8, 16


def mesh(learners: AbstractLearner, count: int) -> Mesh:
    """The local devices that so many learners are laid over ``[learners, tasks]``.

    Where more devices than learners are left, several share the work of each learner, if that is worth it.
    """
    own = devices(count)
    sharing = learners.most_devices(len(jax.local_devices()) // own)
    return Mesh(np.asarray(jax.local_devices()[: own * sharing]).reshape(own, sharing), (_AXIS, _SHARED))


def devices(learners: int) -> int:
    """How many share the learners, whose number is padded to a multiple of it: none that only padding would use."""
    share = math.ceil(learners / len(jax.local_devices()))
    return math.ceil(learners / share)


def close(learners: AbstractLearner) -> None:
    """Nothing is open."""


def spread(learners: AbstractLearner, batch: Any) -> Any:
    """Lays the leading axis of a stacked PyTree ``[learners, ...]`` over the learners' devices; they must divide it."""
    everywhere = mesh(learners, _length(batch))

    def place(leaf: Any) -> jax.Array:
        return jax.device_put(leaf, NamedSharding(everywhere, P(_AXIS) if jnp.ndim(leaf) else P()))

    return jax.tree.map(place, batch)


class Chunk(NamedTuple):
    """What a chunk of steps leaves behind, ``[learners, ...]``.

    Attributes:
        states: the learners' states.
        totals: sums of the metrics since the last report.
        broken: the first step of the chunk, counted from 1, with a metric that was not finite; 0 for none.
        report: the learners' reports, or zeros where none was asked for.
    """

    states: Any
    totals: Metrics
    broken: Int[Array, "learners"]
    report: dict[str, Any]


def compile(learners: AbstractLearner, keys: Keys) -> None:
    """Compiles the programs that `start` and `advance` will look for. They must be laid out by `spread`."""
    everywhere = mesh(learners, keys.shape[0])
    started = _start_with(learners).lower(learners, keys, everywhere).compile()

    def known(info: Any, sharding: Any) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct(info.shape, info.dtype, sharding=sharding)

    states, totals = jax.tree.map(known, started.out_info, started.output_shardings)
    settings = (np.int32(0), np.bool_(False), np.bool_(False))
    _advance_on(everywhere).lower(learners, states, totals, *settings, everywhere).compile()


def start(learners: AbstractLearner, keys: Keys) -> tuple[Any, Metrics]:
    """The states ``[learners, ...]`` before the first step, and the metrics' sums, all zero."""
    return _start_with(learners)(learners, keys, mesh(learners, keys.shape[0]))


def advance(learners: AbstractLearner, states: Any, totals: Metrics, steps: int, *, fresh: bool, report: bool) -> Chunk:
    """Takes ``steps`` steps with every learner.

    The number of steps is an input of the program, as is whether to report: chunks of any length, none included, share
    one program, and a run cut into other chunks takes bit for bit the same steps.
    The states and totals given are consumed.

    Args:
        learners: ``[learners, ...]``.
        states: ``[learners, ...]``.
        totals: sums of the metrics so far ``[learners, ...]``.
        steps: how many.
        fresh: start the sums anew.
        report: let every learner report at the end.
    """
    shared = mesh(learners, _length(totals))
    settings = (np.int32(steps), np.bool_(fresh), np.bool_(report))
    return _advance_on(shared)(learners, states, totals, *settings, shared)


def shapes(learners: AbstractLearner, keys: Keys) -> tuple[Any, Any, Any]:
    """What states, totals and reports look like, without computing any ``[learners, ...]``."""
    states, totals = jax.eval_shape(jax.vmap(_start_one, in_axes=(_axes(learners), 0)), learners, keys)
    return states, totals, jax.eval_shape(jax.vmap(_report_one, in_axes=(_axes(learners), 0)), learners, states)


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
        finite = jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(metrics)]).all()
        broken = jnp.where((broken == 0) & ~finite, index + 1, broken)
        return state, jax.tree.map(jnp.add, totals, metrics), broken

    totals = jax.tree.map(lambda leaf: jnp.where(fresh, jnp.zeros_like(leaf), leaf), totals)
    state, totals, broken = jax.lax.fori_loop(0, steps, body, (state, totals, jnp.zeros((), jnp.int32)))
    told = jax.lax.cond(report, lambda: learner.report(state), lambda: _zeros(jax.eval_shape(learner.report, state)))
    return Chunk(state, totals, broken, told)


def _zeros(shapes: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


def _axes(inputs: Any) -> Any:
    """The learners' axis of every leaf; 0-d leaves are shared by all learners."""
    return jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, inputs)


def _length(batch: Any) -> int:
    """How many learners a stacked PyTree is of ``[learners, ...]``."""
    return next(leaf.shape[0] for leaf in jax.tree.leaves(batch) if jnp.ndim(leaf))


def _mapped(function: Any, devices: Mesh, learners: AbstractLearner, *others: Any) -> Any:
    """A function of stacks of learners ``[learners, ...]``, on each device for its own share of them."""
    inputs = (learners.over(_SHARED) if devices.shape[_SHARED] > 1 else learners, *others)
    specs = jax.tree.map(lambda leaf: P(_AXIS) if jnp.ndim(leaf) else P(), inputs)
    return jax.shard_map(function, mesh=devices, in_specs=specs, out_specs=P(_AXIS), check_vma=False)(*inputs)


def _start_stack(learners: AbstractLearner, keys: Keys) -> tuple[Any, Metrics]:
    return jax.vmap(_start_one, in_axes=(_axes(learners), 0))(learners, keys)


def _advance_stack(learners: AbstractLearner, states: Any, totals: Metrics, *settings: Array) -> Chunk:
    """A device's share of the learners, `at_a_time` of them after the others."""
    count = jax.tree.leaves(totals)[0].shape[0]
    size = at_a_time(learners, count)
    side_by_side = jax.vmap(_advance_one, in_axes=(_axes(learners), 0, 0, None, None, None))
    advance = _advance_alone if in_turn(learners) else side_by_side
    if size == count:
        return advance(learners, states, totals, *settings)

    def one_block(block: Int[Array, ""], chunk: Chunk) -> Chunk:
        def here(leaf: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(leaf, block * size, size)

        def there(old: Array, new: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(old, new, block * size, 0)

        own = jax.tree.map(lambda leaf: here(leaf) if jnp.ndim(leaf) else leaf, learners)
        # In place: no second copy of all the replays is made.
        return jax.tree.map(there, chunk, advance(own, *jax.tree.map(here, (chunk.states, chunk.totals)), *settings))

    shapes = jax.eval_shape(side_by_side, learners, states, totals, *settings)
    start = Chunk(states, totals, *_zeros((shapes.broken, shapes.report)))
    return jax.lax.fori_loop(0, count // size, one_block, start)


def _advance_alone(learners: AbstractLearner, states: Any, totals: Metrics, *settings: Array) -> Chunk:
    """A stack of one learner, without the axis of the stack: no convolution is to be batched over it."""
    one = jax.tree.map(lambda leaf: leaf[0] if jnp.ndim(leaf) else leaf, (learners, states, totals))
    return jax.tree.map(lambda leaf: leaf[None], _advance_one(*one, *settings))


def at_a_time(learners: AbstractLearner, count: int) -> int:
    """How many of a device's learners take all steps of a chunk side by side; it divides their number.

    On CPUs what some ten learners compute in a step stays in a core's own cache. With a hundred it does not, and the
    cores get in each other's way. With fewer, starting the kernels is what costs; of convolutional learners one alone
    fills the cache. Other devices take all at once.
    """
    if jax.default_backend() != "cpu":
        return count
    if in_turn(learners):
        return 1
    return max((size for size in range(_FEWEST, _MOST + 1) if count % size == 0), default=count)


def _start_all(learners: AbstractLearner, keys: Keys, devices: Mesh) -> tuple[Any, Metrics]:
    return _mapped(_start_stack, devices, learners, keys)


def _advance_all(
    learners: AbstractLearner,
    states: Any,
    totals: Metrics,
    steps: Int[Array, ""],
    fresh: Bool[Array, ""],
    report: Bool[Array, ""],
    devices: Mesh,
) -> Chunk:
    return _mapped(_advance_stack, devices, learners, states, totals, steps, fresh, report)


# What runs once is compiled as fast as can be; what runs for long, well; starts on maps too, which ask a network a lot.
_start_simply, _start_on_maps = (
    jax.jit(_start_all, static_argnames="devices", compiler_options=options)
    for options in (QUICK_TO_COMPILE, QUICK_TO_RUN)
)
_advance_on_one, _advance_on_many = (
    jax.jit(_advance_all, static_argnames="devices", donate_argnames=("states", "totals"), compiler_options=options)
    for options in (QUICK_TO_RUN, QUICK_TO_RUN | ONE_THREAD | PATIENT)
)


def _start_with(learners: AbstractLearner) -> Any:
    return _start_on_maps if in_turn(learners) else _start_simply


def _advance_on(devices: Mesh) -> Any:
    return _advance_on_many if devices.size > 1 else _advance_on_one
