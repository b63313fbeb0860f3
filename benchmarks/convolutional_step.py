"""The second-order step of Algorithm 1 with the convolutional network: its data, its arithmetic, its gradient."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from upslope.equations.maml import meta_gradient
from upslope.meta_training.posteriors import NetworkPosterior
from upslope.networks.convolution import ON_GPUS, Precision
from upslope.networks.convolution_forms import FORMS
from upslope.networks.dueling import DuelingQ
from upslope.types import Scalar, Transition

SIZE, CHANNELS, ACTIONS, KERNELS, HIDDEN = (10, 10), 4, 4, 32, (128, 128)
INNER_STEP_SIZE = 0.05


@dataclass(frozen=True)
class Sizes:
    """Of one outer gradient."""

    tasks: int = 10
    batch: int = 32


def outer_gradient(
    target: str, *, inner_steps: int = 1, task_by_task: bool = True, **settings: Any
) -> Callable[..., tuple[Scalar, DuelingQ]]:
    """Algorithm 1's outer loss of all tasks and its gradient, a function of θ and of their samples.

    Args:
        target: of Eq. 7, "stopped" or "kept".
        inner_steps: N.
        task_by_task: one task after the other instead of all at once.
        settings: others of `NetworkPosterior`.
    """
    posterior = NetworkPosterior(
        inner_step_size=INNER_STEP_SIZE,
        inner_steps=inner_steps,
        outer_target="stopped" if target == "stopped" else "kept",
        target_decay=None,
        **settings,
    )
    return partial(meta_gradient, posterior.adapt, posterior.distance, in_sequence=task_by_task)


def network(form: str, precision: Precision = "float32") -> DuelingQ:
    """θ, the same in every form of the convolution."""
    if form not in FORMS:
        raise SystemExit(f"There is no form {form!r} of the convolution: choose among {', '.join(FORMS)}.")
    theta = DuelingQ(jax.random.key(0), (*SIZE, CHANNELS), ACTIONS, HIDDEN)
    return eqx.tree_at(lambda net: net.torso, theta, replace(theta.torso, convolution=form, precision=precision))


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


def large_product(precision: Precision = "float32", size: int = 2048) -> Callable[[], object]:
    """A large matrix product: the machine's rate, as XLA reaches it, with what convolutions multiply in on a GPU."""
    matrix = jax.random.normal(jax.random.key(2), (size, size))

    @jax.jit
    def multiply(a: jax.Array) -> jax.Array:
        with jax.default_matmul_precision(ON_GPUS[precision] if jax.default_backend() == "gpu" else "float32"):
            return a @ a

    return lambda: jax.block_until_ready(multiply(matrix))
