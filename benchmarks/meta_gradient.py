"""The second-order step of Algorithm 1 with the convolutional network, against its arithmetic and against PyTorch.

``python -m benchmarks.meta_gradient`` writes ``benchmarks/results/meta_gradient.json``. PyTorch takes part where it is
installed (``pip install torch==2.13.0``).
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.sharding import NamedSharding, PartitionSpec

from benchmarks import harness
from benchmarks.harness import Bar, Part, Row
from upslope.convolution import FORMS, fastest_form
from upslope.meta_training import MetaTraining, TaskSamples
from upslope.networks import DuelingQ
from upslope.recipes import MetaTrainingConfig
from upslope.run.compiling import ONE_THREAD, set_up_devices
from upslope.tasks import clean_maps
from upslope.types import Transition

SIZE, CHANNELS, ACTIONS, KERNELS, HIDDEN = (10, 10), 4, 4, 32, (128, 128)
INNER_STEP_SIZE = 0.05

#: The forms of the convolution worth timing in every run; ``--forms`` names others.
IN_THE_RUN = ("closed", "patches", "shifts", "winograd")


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        tasks: numbers of tasks, each with weights of its own in the inner step. The first of them is timed with all
            forms and both targets of Eq. 7, the others with the default form and the default target.
        batch: transitions of each task.
        forms: of the convolution: lax takes minutes.
        side_by_side: also all tasks side by side instead of one after the other.
        torch: PyTorch too, if it is installed.
    """

    tasks: tuple[int, ...] = (10, 40, 160)
    batch: int = 32
    forms: tuple[str, ...] = IN_THE_RUN
    side_by_side: bool = False
    torch: bool = True


@dataclass(frozen=True)
class Sizes:
    """Of one outer gradient."""

    tasks: int = 10
    batch: int = 32


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    set_up_devices(harness.scratch())
    numbers = options.tasks[:1] if options.quick else options.tasks
    parts: dict[str, Part] = {
        "a product of two matrices of 2,048 × 2,048": Part(large_product(), {"operations": 2 * 2048**3})
    }
    work: dict[str, float] = {}
    for index, count in enumerate(numbers):
        sizes = Sizes(2 if options.quick else count, options.batch)
        forms = options.forms if index == 0 else (fastest_form(adapted=True),)
        for target in ("stopped", "kept") if index == 0 else ("stopped",):
            found = parts_of(sizes, forms, target, options)
            parts |= found
            work |= {name: operations(sizes, target) for name in found}
            for form in forms if index == 0 else ():
                name = f"{sizes.tasks} tasks, {target}: upslope, {form}, a learner on each core"
                parts[name] = Part(a_learner_on_each_core(sizes, form, target))
                work[name] = operations(sizes, target) * jax.device_count()
    rows = harness.time_in_turns(parts, options.repeats)
    rate = next(iter(rows.values()))["operations/s"]
    for name, operations_needed in work.items():
        rows[name]["share of the product's rate"] = operations_needed / rate / rows[name]["median"]
    harness.write("meta_gradient", options, rows, bars=bars(rows, numbers), operations=work, matmul_rate=rate)


def parts_of(sizes: Sizes, forms: tuple[str, ...], target: str, options: Options) -> dict[str, Part]:
    """Upslope's step in each form, and PyTorch's, by name."""
    name = f"{sizes.tasks} tasks, {target}: {{}}".format
    found = {name(f"upslope, {form}"): Part(upslope_step(sizes, form, target)) for form in forms}
    if options.side_by_side:
        for form in forms:
            step = upslope_step(sizes, form, target, task_by_task=False)
            found[name(f"upslope, {form}, side by side")] = Part(step)
    if options.torch and importlib.util.find_spec("torch") is not None:
        from benchmarks.peers.torch_meta_gradient import peer_steps

        batch = jax.tree.map(np.asarray, transitions(sizes))
        for peer, step in peer_steps(batch, network(fastest_form(adapted=True)), INNER_STEP_SIZE).items():
            found[name(peer)] = Part(partial(step, target))
    return found


def bars(rows: dict[str, Row], numbers: tuple[int, ...]) -> list[Bar]:
    """70 % of the matmul rate, and 2.5 times PyTorch, with the default form."""
    found = []
    for name, row in rows.items():
        which = name.split(":")[0]
        if name != f"{which}: upslope, {fastest_form(adapted=True)}":
            continue
        share = row["share of the product's rate"]
        found.append(Bar(f"{which}: at least 70 % of the machine's matmul rate", share, 0.7, bound=_BOUND))
        peers = [other["median"] for key, other in rows.items() if key.startswith(f"{which}: PyTorch")]
        ratio = min(peers) / row["median"] if peers else None
        found.append(Bar(f"{which}: at least 2.5 × the faster of PyTorch's", ratio, 2.5, bound=_BOUND))
    return found


_BOUND = (
    "memory: a layer's patches are nine times its input, are written and read once for each product, and the products "
    "are narrow (32 columns), where a matrix product reaches a part of a large one's rate"
)


def upslope_step(
    sizes: Sizes, form: str, target: str, *, task_by_task: bool = True
) -> Callable[[], tuple[Any, DuelingQ]]:
    """Algorithm 1's own outer gradient on random transitions, TD targets made with it, by one forward pass of θ."""
    step = jax.jit(outer_gradient(sizes, target, task_by_task=task_by_task))
    theta, samples = network(form), TaskSamples(transitions(sizes), None)
    return lambda: jax.block_until_ready(step(theta, samples))


def a_learner_on_each_core(sizes: Sizes, form: str, target: str) -> Callable[[], Any]:
    """As many such gradients as there are devices, as several seeds are meta-trained: a device for each core."""
    mesh = jax.make_mesh((jax.device_count(),), ("cores",))
    gradient = outer_gradient(sizes, target)

    def own(batch: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], gradient(*jax.tree.map(lambda leaf: leaf[0], batch)))

    cores = PartitionSpec("cores")
    step = jax.jit(
        jax.shard_map(own, mesh=mesh, in_specs=(cores,), out_specs=cores, check_vma=False), compiler_options=ONE_THREAD
    )
    each = network(form), TaskSamples(transitions(sizes), None)
    every = jax.tree.map(lambda leaf: jnp.stack([leaf] * jax.device_count()), each)
    batch = jax.device_put(every, NamedSharding(mesh, cores))
    return lambda: jax.block_until_ready(step(batch))


def outer_gradient(sizes: Sizes, target: str, *, task_by_task: bool = True) -> Callable[..., Any]:
    """Algorithm 1's, of the outer loss of all tasks."""
    config = MetaTrainingConfig(
        tasks=sizes.tasks, batch_size=sizes.batch, hidden=HIDDEN, activation="relu", inner_step_size=INNER_STEP_SIZE,
        outer_target="stopped" if target == "stopped" else "kept", target_decay=None, task_by_task=task_by_task,
    )  # fmt: skip
    return MetaTraining(clean_maps(), config).outer_gradient


def network(form: str) -> DuelingQ:
    """θ, the same in every form of the convolution."""
    if form not in FORMS:
        raise SystemExit(f"There is no form {form!r} of the convolution: choose among {', '.join(FORMS)}.")
    theta = DuelingQ(jax.random.key(0), (*SIZE, CHANNELS), ACTIONS, HIDDEN)
    return eqx.tree_at(lambda net: net.torso, theta, replace(theta.torso, convolution=form))


def transitions(sizes: Sizes) -> Transition:
    """Random 0/1 maps ``[tasks, batch, height, width, channels]``, actions and rewards."""
    keys = jax.random.split(jax.random.key(1), 4)
    leading = (sizes.tasks, sizes.batch)
    shape = (*leading, *SIZE, CHANNELS)
    return Transition(
        jax.random.bernoulli(keys[0], 0.05, shape).astype(jnp.float32),
        jax.random.randint(keys[1], leading, 0, ACTIONS),
        jax.random.normal(keys[2], leading),
        jnp.full(leading, 0.9),
        jax.random.bernoulli(keys[3], 0.05, shape).astype(jnp.float32),
    )


def operations(sizes: Sizes, target: str) -> float:
    """Floating-point operations that one outer gradient needs, products only: two for each multiplication and addition.

    A layer's forward pass is one product, its backward pass two (by weights and by inputs; the first layer's inputs
    need none). Stopped: Q_θ of s′ and s and Q_φ of s forward, the inner and the outer gradient back. Kept: besides, the
    outer gradient goes back through Q_φ, and through the inner gradient: twice as many products as that has itself, and
    once more back through its forward pass, which carries the direct gradient of Q_θ along.
    """
    height, width = SIZE
    cells, states = height * width, sizes.tasks * sizes.batch
    layers = [9 * CHANNELS * KERNELS * cells] + [9 * KERNELS * KERNELS * cells] * 3
    widths = (cells * KERNELS, *HIDDEN)
    layers += [n * m for n, m in zip(widths[:-1], HIDDEN, strict=True)] + [HIDDEN[-1] * (ACTIONS + 1)]
    forward, backward = sum(layers), 2 * sum(layers) - layers[0]
    passes = 3 * forward + 2 * backward
    if target == "kept":
        passes += backward + 2 * backward
    return 2.0 * states * passes


def large_product(size: int = 2048) -> Callable[[], object]:
    """A large float32 matrix product: the machine's rate, as XLA reaches it."""
    matrix = jax.random.normal(jax.random.key(2), (size, size))
    multiply = jax.jit(lambda a: a @ a)
    return lambda: jax.block_until_ready(multiply(matrix))


if __name__ == "__main__":
    main(tyro.cli(Options))
