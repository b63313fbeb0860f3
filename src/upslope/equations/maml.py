"""Model-agnostic meta-learning, Eqs. 2 and 3: for any way to adapt, and any loss between θ and φ."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax

from upslope.errors import UpslopeError
from upslope.types import Scalar

Params = TypeVar("Params")
Data = TypeVar("Data")

#: A squared gradient below this is no direction to go in.
_FLAT = 1e-12


def descend(params: Params, gradient: Params, step_size: float | Scalar) -> Params:
    """One step of gradient descent: params − step_size·gradient, leaf by leaf."""
    return jax.tree.map(lambda p, g: p - step_size * g, params, gradient)


def adapt(
    loss: Callable[[Params, Data], Scalar],
    params: Params,
    data: Data,
    *,
    step_size: float | Scalar,
    steps: int = 1,
    first_order: bool = False,
    rematerialise: bool = False,
    normalised: bool = False,
) -> Params:
    """Eq. 2, N times: φ ← φ − α·∇L(φ), from φ = θ.

    Args:
        loss: L of one task; a function of the parameters and that task's data.
        params: θ.
        data: the task's samples, the same for each of the N steps.
        step_size: α.
        steps: N ≥ 1.
        first_order: treat the inner gradients as constants, so that no second derivative is taken through φ(θ).
        rematerialise: keep of each step only the φ it began with, and compute the rest again when differentiating:
            the same numbers in less memory and more time.
        normalised: Polyak's step, 2α·L / ‖∇L‖²·∇L: of a single squared error, however steep, it removes the share α,
            to first order.

    Raises:
        UpslopeError: N < 1.
    """
    if steps < 1:
        raise UpslopeError(f"inner_steps is {steps}, but adapting takes at least one step: give N >= 1.")
    gradient_of = jax.value_and_grad(loss)

    def step(params: Params, _: None) -> tuple[Params, None]:
        error, gradient = gradient_of(params, data)
        if first_order:
            error, gradient = jax.lax.stop_gradient((error, gradient))
        return descend(params, gradient, step_size * _polyak(error, gradient) if normalised else step_size), None

    # A few steps are written out, many are a loop: the program stays small.
    step = jax.checkpoint(step) if rematerialise else step
    return jax.lax.scan(step, params, None, length=steps, unroll=steps if steps <= 4 else 1)[0]


def _polyak(error: Scalar, gradient: Params) -> Scalar:
    """The step at which a squared error that is linear in the parameters would vanish."""
    return 2 * error / jnp.maximum(optax.tree.norm(gradient, squared=True), _FLAT)


def meta_loss(
    adapt_to: Callable[[Params, Data], Any],
    distance: Callable[[Params, Any, Data], Scalar],
    params: Params,
    data: Data,
) -> Scalar:
    """The objective under ∇ in Eq. 3: E_i of L_i(θ, φ_i), with φ_i adapted from θ (Eq. 2).

    MAML's own L_i is the task's loss of φ_i; Algorithm 1's is the distance of Q_θ and Q_φ (Eq. 7).

    Args:
        adapt_to: θ and one task's data to φ_i.
        distance: L_i: θ, φ_i and the task's data to a number.
        params: θ.
        data: the tasks' samples ``[tasks, ...]``.
    """
    return jnp.mean(jax.vmap(lambda task: distance(params, adapt_to(params, task), task))(data))


def meta_gradient(
    adapt_to: Callable[[Params, Data], Any],
    distance: Callable[[Params, Any, Data], Scalar],
    params: Params,
    data: Data,
    *,
    in_sequence: bool = False,
) -> tuple[Scalar, Params]:
    """`meta_loss` and its gradient with respect to θ, the ∇ of Eq. 3.

    Args:
        adapt_to: see `meta_loss`.
        distance: likewise.
        params: θ.
        data: the tasks' samples ``[tasks, ...]``.
        in_sequence: take the tasks one after the other: the same numbers with the memory of one task. Networks with
            convolutions need it on CPUs: side by side the adapted weights turn every convolution into a batch of them.
    """
    if not in_sequence:
        return jax.value_and_grad(meta_loss, argnums=2)(adapt_to, distance, params, data)
    count = jax.tree.leaves(data)[0].shape[0]

    def loss(theta: Params, task: Data) -> Scalar:
        return distance(theta, adapt_to(theta, task), task)

    def add(total: tuple[Scalar, Params], task: Data) -> tuple[tuple[Scalar, Params], None]:
        # XLA would take out of the loop what only θ is needed for, and then no longer see that passes are the same.
        theta, task = jax.lax.optimization_barrier((params, task))
        # Differentiated in here, nothing of one task is kept for the next.
        return jax.tree.map(jnp.add, total, jax.value_and_grad(loss)(theta, task)), None

    nothing = (jnp.zeros(()), jax.tree.map(jnp.zeros_like, params))
    total, _ = jax.lax.scan(add, nothing, data)
    return jax.tree.map(lambda leaf: leaf / count, total)


def outer_step(
    adapt_to: Callable[[Params, Data], Any],
    distance: Callable[[Params, Any, Data], Scalar],
    params: Params,
    data: Data,
    *,
    step_size: float | Scalar,
) -> Params:
    """Eq. 3: θ ← θ − β·∇_θ E_i L_i(θ, φ_i), by plain gradient descent over tasks ``[tasks, ...]``."""
    return descend(params, meta_gradient(adapt_to, distance, params, data)[1], step_size)
