"""The second-order step of Algorithm 1 with the convolutional network, against its arithmetic and against PyTorch.

``python -m benchmarks.meta_gradient`` writes ``benchmarks/results/meta_gradient.json``. PyTorch takes part where it is
installed (``pip install torch==2.13.0``).
"""

import importlib.util
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from upslope.convolution import FORMS
from upslope.meta_training import MetaTraining, TaskSamples
from upslope.networks import DuelingQ
from upslope.recipes import MetaTrainingConfig
from upslope.run.compiling import compile_clock
from upslope.run.machine import hardware, versions
from upslope.tasks import clean_maps
from upslope.types import Transition

RESULTS = Path(__file__).parent / "results" / "meta_gradient.json"
SIZE, CHANNELS, ACTIONS, KERNELS, HIDDEN = (10, 10), 4, 4, 32, (128, 128)

#: The forms of the convolution worth timing in every run; ``--forms`` names others.
IN_THE_RUN = ("closed", "patches", "shifts")


@dataclass(frozen=True)
class Options:
    """What to time."""

    repeats: int = 5
    """Of each part, in turns, after one run that compiles."""
    tasks: int = 10
    """Tasks, each with weights of its own in the inner step."""
    batch: int = 32
    """Transitions of each task."""
    forms: tuple[str, ...] = IN_THE_RUN
    """Forms of the convolution: lax takes minutes."""
    side_by_side: bool = False
    """Also all tasks side by side instead of one after the other."""
    torch: bool = True
    """PyTorch too, if it is installed."""


def main(options: Options) -> None:
    """Times everything asked for, in turns."""
    parts: dict[str, tuple[str, Callable[[], object]]] = {}
    for target in ("stopped", "kept"):
        for form in options.forms:
            for task_by_task in (True, False) if options.side_by_side else (True,):
                how = "one task after the other" if task_by_task else "side by side"
                parts[f"upslope, {form}, {how}, {target}"] = (target, upslope_step(options, form, target, task_by_task))
    peers = torch_steps(options) if options.torch else {}
    parts |= peers
    product, rate_of = large_product()
    compiling = {name: _compile_seconds(part) for name, (_, part) in parts.items()}
    seconds: dict[str, list[float]] = {name: [] for name in parts}
    rates: list[float] = []
    for _ in range(options.repeats):
        for name, (_, part) in parts.items():
            began = time.perf_counter()
            part()
            seconds[name].append(time.perf_counter() - began)
            began = time.perf_counter()
            product()
            rates.append(rate_of(time.perf_counter() - began))
    rate = float(np.median(rates))
    work = {target: operations(options, target) for target in ("stopped", "kept")}
    rows = {
        name: _row(times, work[parts[name][0]] / rate) | {"compiling": compiling[name]}
        for name, times in seconds.items()
    }
    content = {
        "rows": rows,
        "operations": work,
        "matmul_rate": {"median": rate, "fastest": max(rates), "slowest": min(rates)},
        "settings": {"tasks": options.tasks, "batch": options.batch, "repeats": options.repeats, "size": SIZE},
        "versions": versions(),
        "hardware": hardware(),
    }
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    _print(rows, rate)
    if options.torch and not peers:
        print("PyTorch is not installed, so no peer took part: pip install torch==2.13.0.")


def upslope_step(options: Options, form: str, target: str, task_by_task: bool) -> Callable[[], object]:
    """Algorithm 1's own outer gradient on random transitions, TD targets made with it, by one forward pass of θ."""
    config = MetaTrainingConfig(
        tasks=options.tasks, batch_size=options.batch, hidden=HIDDEN, activation="relu", inner_step_size=0.05,
        outer_target=target, target_decay=None, task_by_task=task_by_task,
    )  # fmt: skip
    meta = MetaTraining(clean_maps(), config)
    network = DuelingQ(jax.random.key(0), (*SIZE, CHANNELS), ACTIONS, HIDDEN)
    theta = _in_form(network, form)
    samples = TaskSamples(transitions(options), None)
    step = jax.jit(meta.outer_gradient)
    return lambda: jax.block_until_ready(step(theta, samples))


def transitions(options: Options) -> Transition:
    """Random 0/1 maps ``[tasks, batch, height, width, channels]``, actions and rewards."""
    keys = jax.random.split(jax.random.key(1), 4)
    leading = (options.tasks, options.batch)
    shape = (*leading, *SIZE, CHANNELS)
    return Transition(
        jax.random.bernoulli(keys[0], 0.05, shape).astype(jnp.float32),
        jax.random.randint(keys[1], leading, 0, ACTIONS),
        jax.random.normal(keys[2], leading),
        jnp.full(leading, 0.9),
        jax.random.bernoulli(keys[3], 0.05, shape).astype(jnp.float32),
    )


def operations(options: Options, target: str) -> float:
    """Floating-point operations that one outer gradient needs, products only: two for each multiplication and addition.

    A layer's forward pass is one product, its backward pass two (by weights and by inputs; the first layer's inputs
    need none). Stopped: Q_θ of s′ and s and Q_φ of s forward, the inner and the outer gradient back. Kept: besides, the
    outer gradient goes back through Q_φ, and through the inner gradient: twice as many products as that has itself, and
    once more back through its forward pass, which carries the direct gradient of Q_θ along.
    """
    height, width = SIZE
    cells, states = height * width, options.tasks * options.batch
    sizes = [9 * CHANNELS * KERNELS * cells] + [9 * KERNELS * KERNELS * cells] * 3
    widths = (cells * KERNELS, *HIDDEN)
    sizes += [n * m for n, m in zip(widths[:-1], HIDDEN, strict=True)] + [HIDDEN[-1] * (ACTIONS + 1)]
    forward, backward = sum(sizes), 2 * sum(sizes) - sizes[0]
    passes = 3 * forward + 2 * backward
    if target == "kept":
        passes += backward + 2 * backward
    return 2.0 * states * passes


def large_product(size: int = 2048) -> tuple[Callable[[], object], Callable[[float], float]]:
    """A large float32 matrix product, and operations per second by the seconds it took."""
    matrix = jax.random.normal(jax.random.key(2), (size, size))
    multiply = jax.jit(lambda a: a @ a)
    jax.block_until_ready(multiply(matrix))
    return lambda: jax.block_until_ready(multiply(matrix)), lambda seconds: 2 * size**3 / seconds


def torch_steps(options: Options) -> dict[str, tuple[str, Callable[[], object]]]:
    """The same step in PyTorch, by a loop over tasks and by torch.func; nothing if it is not installed."""
    if importlib.util.find_spec("torch") is None:
        return {}
    from benchmarks.torch_meta_gradient import peer_steps

    batch = jax.tree.map(np.asarray, transitions(options))
    return peer_steps(batch, KERNELS, HIDDEN, ACTIONS)


def _in_form(network: DuelingQ, form: str) -> DuelingQ:
    if form not in FORMS:
        raise SystemExit(f"There is no form {form!r} of the convolution: choose among {', '.join(FORMS)}.")
    return eqx.tree_at(lambda net: net.torso, network, replace(network.torso, convolution=form))


def _compile_seconds(part: Callable[[], object]) -> float:
    with compile_clock() as clock:
        part()
    return clock.seconds


def _row(times: list[float], ideal: float) -> dict[str, float]:
    median = float(np.median(times))
    return {"median": median, "fastest": min(times), "slowest": max(times), "times_its_arithmetic": median / ideal}


def _print(rows: dict[str, dict[str, float]], rate: float) -> None:
    table = Table("", "ms", "range", "times its arithmetic", "compiling, s", title="One outer gradient of Algorithm 1")
    for name, row in rows.items():
        span = f"{1e3 * row['fastest']:.0f} to {1e3 * row['slowest']:.0f}"
        share = f"{row['times_its_arithmetic']:.2f}"
        table.add_row(name, f"{1e3 * row['median']:.0f}", span, share, f"{row['compiling']:.1f}")
    Console().print(table)
    print(f"A large product runs at {rate / 1e9:.0f} GFLOP/s. Written to {RESULTS}.")


if __name__ == "__main__":
    main(tyro.cli(Options))
