"""The second-order step of Algorithm 1 with the convolutional network, against its arithmetic and against PyTorch.

``python -m benchmarks.meta_gradient`` writes ``benchmarks/results/meta_gradient.json``. PyTorch takes part where it is
installed (``pip install torch==2.13.0``).
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.sharding import NamedSharding, PartitionSpec

from benchmarks import harness
from benchmarks.convolutional_step import (
    INNER_STEP_SIZE,
    Sizes,
    large_product,
    network,
    operations,
    outer_gradient,
    transitions,
)
from benchmarks.harness import Bar, Part, Row
from upslope.compiler_options import ONE_THREAD
from upslope.learners.sharing import mean_of_all, own_tasks
from upslope.meta_training.posteriors.network import TaskBatch
from upslope.networks.convolution import Precision, fastest_form
from upslope.networks.convolution_forms import FORMS
from upslope.networks.dueling import DuelingQ
from upslope.run.compiling import set_up_devices

#: The forms of the convolution worth timing in every run; ``--forms`` names others.
IN_THE_RUN = ("patches", "rows", "shifts", "winograd")


@dataclass(frozen=True)
class Options(harness.Options):
    """What to time.

    Attributes:
        tasks: numbers of tasks, each with its own weights in the inner step. The first of them is timed with all
            forms and both targets of Eq. 7, the others with the default form and the default target.
        batch: transitions of each task.
        forms: of the convolution: lax takes minutes.
        side_by_side: also all tasks at once instead of one after the other.
        torch: PyTorch too, if it is installed; on CPUs and in float32 only, as its form here knows no other.
        precision: of what convolutions multiply, and the large product with them; CPUs only round.
    """

    tasks: tuple[int, ...] = (10, 40, 160)
    batch: int = 32
    forms: tuple[str, ...] = IN_THE_RUN
    side_by_side: bool = False
    torch: bool = True
    precision: Precision = "float32"


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    set_up_devices(harness.scratch())
    numbers = options.tasks[:1] if options.quick else options.tasks
    parts: dict[str, Part] = {
        "a product of two matrices of 2,048 × 2,048": Part(
            large_product(options.precision), {"operations": 2 * 2048**3}
        )
    }
    work: dict[str, float] = {}
    for index, count in enumerate(numbers):
        sizes = Sizes(2 if options.quick else count, options.batch)
        forms = options.forms if index == 0 else (fastest_form(),)
        for target in ("stopped", "kept") if index == 0 else ("stopped",):
            found = parts_of(sizes, forms, target, options)
            parts |= found
            work |= {name: operations(sizes, target) for name in found}
            for form in forms if index == 0 and jax.device_count() > 1 else ():
                name = f"{sizes.tasks} tasks, {target}: upslope, {form}, {EACH_CORE}"
                parts[name] = Part(a_learner_on_each_core(sizes, form, target, options.precision))
                work[name] = operations(sizes, target) * jax.device_count()
            if jax.device_count() > 1 and sizes.tasks % jax.device_count() == 0:
                name = f"{sizes.tasks} tasks, {target}: upslope, {fastest_form()}, {SHARED}"
                parts[name] = Part(shared_by_the_cores(sizes, fastest_form(), target, options.precision))
                work[name] = operations(sizes, target)
    rows = harness.time_in_turns(parts, options.repeats)
    rate = next(iter(rows.values()))["operations/s"]
    for name, operations_needed in work.items():
        rows[name][SHARE] = operations_needed / rate / rows[name]["median"]
    harness.write("meta_gradient", options, rows, bars=bars(rows), operations=work, matmul_rate=rate)


def parts_of(sizes: Sizes, forms: tuple[str, ...], target: str, options: Options) -> dict[str, Part]:
    """Upslope's step in each form, and PyTorch's, by name."""
    name = f"{sizes.tasks} tasks, {target}: {{}}".format
    precision = options.precision
    found = {name(f"upslope, {form}"): Part(upslope_step(sizes, form, target, precision)) for form in forms}
    if options.side_by_side:
        for form in forms:
            step = upslope_step(sizes, form, target, precision, task_by_task=False)
            found[name(f"upslope, {form}, side by side")] = Part(step)
    comparable = precision == "float32" and jax.default_backend() == "cpu"
    if options.torch and comparable and importlib.util.find_spec("torch") is not None:
        from benchmarks.peers.torch_meta_gradient import peer_steps

        batch = jax.tree.map(np.asarray, transitions(sizes))
        for peer, step in peer_steps(batch, network(fastest_form()), INNER_STEP_SIZE).items():
            found[name(peer)] = Part(partial(step, target))
    return found


def bars(rows: dict[str, Row]) -> list[Bar]:
    """70 % of the matmul rate, and 2.5 times PyTorch: as one learner does it; on each core with the best form."""
    found = []
    for which in dict.fromkeys(name.split(":")[0] for name in rows if ": " in name):
        own = {name.split(": ")[1]: row for name, row in rows.items() if name.startswith(f"{which}: ")}
        peers = {name: row for name, row in own.items() if name.startswith("PyTorch")}
        default = f"upslope, {fastest_form()}"
        for name in [name for name in (f"{default}, {SHARED}", default) if name in own][:1]:
            found += pair_of_bars(which, name, own, peers, 1)
        each = [name for name in own if name.endswith(EACH_CORE)]
        if each:
            best = min(each, key=lambda name: own[name]["median"])
            found += pair_of_bars(f"{which}, {EACH_CORE}", best, own, peers, jax.device_count())
    return found


def pair_of_bars(which: str, name: str, own: dict[str, Row], peers: dict[str, Row], at_once: int) -> list[Bar]:
    """Both bars of one row, in which several gradients are computed at once."""
    row, form = own[name], name.split(", ")[1]
    share = row[SHARE]
    found = [Bar(f"{which} ({form}): at least 70 % of the machine's matmul rate", share, 0.7, bound=_MEMORY[form])]
    if peers:
        best = min(peers, key=lambda name: peers[name]["median"])
        ratio, rate = at_once * peers[best]["median"] / row["median"], peers[best][SHARE]
        slower = "upslope is slower than it; " if ratio < 1 else ""
        bound = (
            f"{slower}{best} runs at {rate:.2f} of the matmul rate itself, so 2.5 × that is {2.5 * rate:.1f} times the "
            "rate, while Winograd's form needs few enough multiplications for 1.9 times"
        )
        found.append(Bar(f"{which} ({form}): at least 2.5 × the faster of PyTorch's", ratio, 2.5, bound=bound))
    return found


EACH_CORE, SHARED, SHARE = "a learner on each core", "its tasks shared by the cores", "share of the product's rate"

_NARROW = "the products are narrow (32 columns), where a matrix product reaches only a part of the rate of a large one"
_MEMORY: dict[str, str] = dict.fromkeys(FORMS, f"memory, likely, and {_NARROW}") | {
    "patches": f"memory: a layer's patches are nine times its input and written and read for each product; {_NARROW}",
    "winograd": f"memory: the sums before and after the products, which are half as many as counted here; {_NARROW}",
}


def upslope_step(
    sizes: Sizes, form: str, target: str, precision: Precision = "float32", *, task_by_task: bool = True
) -> Callable[[], tuple[Any, DuelingQ]]:
    """Algorithm 1's own outer gradient on random transitions, TD targets made with it, by one forward pass of θ."""
    step = jax.jit(outer_gradient(target, task_by_task=task_by_task))
    theta, samples = network(form, precision), TaskBatch(transitions(sizes), None)
    return lambda: jax.block_until_ready(step(theta, samples))


def a_learner_on_each_core(sizes: Sizes, form: str, target: str, precision: Precision) -> Callable[[], Any]:
    """As many such gradients as there are devices, as several seeds are meta-trained: a device for each core."""
    mesh = jax.make_mesh((jax.device_count(),), ("cores",))
    gradient = outer_gradient(target)

    def own(batch: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[None], gradient(*jax.tree.map(lambda leaf: leaf[0], batch)))

    cores = PartitionSpec("cores")
    step = jax.jit(
        jax.shard_map(own, mesh=mesh, in_specs=(cores,), out_specs=cores, check_vma=False), compiler_options=ONE_THREAD
    )
    each = network(form, precision), TaskBatch(transitions(sizes), None)
    every = jax.tree.map(lambda leaf: jnp.stack([leaf] * jax.device_count()), each)
    batch = jax.device_put(every, NamedSharding(mesh, cores))
    return lambda: jax.block_until_ready(step(batch))


def shared_by_the_cores(sizes: Sizes, form: str, target: str, precision: Precision) -> Callable[[], Any]:
    """One such gradient by all devices, each for its share of the tasks, as one learner alone is meta-trained."""
    mesh = jax.make_mesh((jax.device_count(),), ("cores",))
    gradient = outer_gradient(target)

    def own(theta: DuelingQ, samples: TaskBatch) -> Any:
        return mean_of_all(gradient(theta, own_tasks(samples, "cores")), "cores")

    everywhere = PartitionSpec()
    step = jax.jit(
        jax.shard_map(own, mesh=mesh, in_specs=(everywhere, everywhere), out_specs=everywhere, check_vma=False),
        compiler_options=ONE_THREAD,
    )
    batch = network(form, precision), TaskBatch(transitions(sizes), None)
    batch = jax.device_put(batch, NamedSharding(mesh, everywhere))
    return lambda: jax.block_until_ready(step(*batch))


if __name__ == "__main__":
    main(tyro.cli(Options))
