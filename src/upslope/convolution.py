"""The 3 × 3 convolution (stride 1, SAME padding) in forms that are equal, and of very different speed.

XLA's own convolution is fast on CPU only at the top of a program and with weights shared by the batch. Inside a
compiled loop its gradients are some 40 times slower, and weights of each task's own, as in Algorithm 1's inner step,
make it a grouped convolution, which is slower still. Matrix products have neither weakness, and Winograd's algorithm
needs half as many of them.
``python -m benchmarks.meta_gradient`` measures all of it.
"""

import functools
from collections.abc import Callable
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Images = Float[Array, "*batch height width _"]
Kernel = Float[Array, "3 3 inputs outputs"]
Convolution = Literal["lax", "shifts", "patches", "closed", "winograd"]
Precision = Literal["float32", "tensorfloat32", "bfloat16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)


def lax_convolution(images: Images, kernel: Kernel) -> Images:
    """XLA's own."""
    flat = images.reshape(-1, *images.shape[-3:])
    result = jax.lax.conv_general_dilated(flat, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))
    return result.reshape(*images.shape[:-1], kernel.shape[-1])


def shifted_products(images: Images, kernel: Kernel) -> Images:
    """Nine matrix products with shifted images, added up."""
    windows = _windows(images)
    products = [window @ kernel[divmod(index, 3)] for index, window in enumerate(windows)]
    return jnp.sum(jnp.stack(products), axis=0)


def patch_product(images: Images, kernel: Kernel) -> Images:
    """One matrix product with every cell's neighbourhood."""
    return jnp.concatenate(_windows(images), axis=-1) @ kernel.reshape(-1, kernel.shape[-1])


# Winograd's F(4, 3): four neighbouring results of a filter with three taps by six products instead of twelve, by way of
# polynomials at 0, ±1, ±2 and ∞ (Lavin & Gray, Fast Algorithms for Convolutional Neural Networks, 2016, Eq. 14).
_TILE = 4
_TO_POINTS = np.array(
    [
        [4, 0, -5, 0, 1, 0],
        [0, -4, -4, 1, 1, 0],
        [0, 4, -4, -1, 1, 0],
        [0, -2, -1, 2, 1, 0],
        [0, 2, -1, -2, 1, 0],
        [0, 4, 0, -5, 0, 1],
    ]
)
_TAPS_TO_POINTS = np.array([[6, 0, 0], [-4, -4, -4], [-4, 4, -4], [1, 2, 4], [1, -2, 4], [0, 0, 24]]) / 24
_FROM_POINTS = np.array([[1, 1, 1, 1, 1, 0], [0, 1, -1, 2, -2, 0], [0, 1, 1, 4, 4, 0], [0, 1, -1, 8, -8, 1]])


def winograd_convolution(images: Images, kernel: Kernel) -> Images:
    """Winograd's algorithm down the columns, patches along the rows: half the arithmetic, half the patches' memory."""
    height, width, inputs = images.shape[-3:]
    flat = images.reshape(-1, height, width, inputs)
    tiles, points = -(-height // _TILE), len(_TO_POINTS)
    padded = jnp.pad(flat, ((0, 0), (1, tiles * _TILE - height + 1), (1, 1), (0, 0)))
    rows = [padded[:, row : row + (tiles - 1) * _TILE + 1 : _TILE] for row in range(points)]
    at_points = jnp.stack(_combined(rows, _TO_POINTS))
    patches = jnp.concatenate([at_points[..., column : column + width, :] for column in range(3)], axis=-1)
    taps = jnp.tensordot(jnp.asarray(_TAPS_TO_POINTS, kernel.dtype), kernel, 1).reshape(points, 3 * inputs, -1)
    products = (patches.reshape(points, -1, 3 * inputs) @ taps).reshape(*patches.shape[:-1], -1)
    results = jnp.stack(_combined(list(products), _FROM_POINTS), axis=2)
    return results.reshape(-1, tiles * _TILE, *results.shape[3:])[:, :height].reshape(*images.shape[:-1], -1)


def _combined(parts: list[Array], weights: np.ndarray) -> list[Array]:
    """Sums of arrays with a row of weights each; nothing is multiplied by zero."""
    products = ([float(weight) * parts[index] for index, weight in enumerate(row) if weight] for row in weights)
    return [functools.reduce(jnp.add, row) for row in products]


# Three bilinear maps, each with the two others as its derivatives: those of <cotangents, convolution(images, kernel)>.
# However often they are differentiated, only patches and matrix products come out, and nothing is scattered.
# They allow reverse mode only. Under vmap over images the kernel's gradient is made image by image and added up after.


@jax.custom_vjp
def closed_convolution(images: Images, kernel: Kernel) -> Images:
    """Three matrix products of three shifts each, closed under differentiation."""
    return _row_products(images, kernel)


@jax.custom_vjp
def transposed_convolution(cotangents: Images, kernel: Kernel) -> Images:
    """The derivative of `closed_convolution` by its images."""
    return _row_products(cotangents, kernel[::-1, ::-1].swapaxes(2, 3))


@jax.custom_vjp
def correlation(images: Images, cotangents: Images) -> Kernel:
    """The derivative of `closed_convolution` by its kernel."""
    inputs, outputs = images.shape[-1], cotangents.shape[-1]
    columns = _shifted(images, -2, (-1, 0, 1)).reshape(-1, 3 * inputs)
    rows = _shifted(cotangents, -3, (1, 0, -1)).reshape(-1, 3 * outputs)
    return (columns.T @ rows).reshape(3, inputs, 3, outputs).transpose(2, 0, 1, 3)


closed_convolution.defvjp(
    lambda images, kernel: (closed_convolution(images, kernel), (images, kernel)),
    lambda kept, cotangents: (transposed_convolution(cotangents, kept[1]), correlation(kept[0], cotangents)),
)
transposed_convolution.defvjp(
    lambda cotangents, kernel: (transposed_convolution(cotangents, kernel), (cotangents, kernel)),
    lambda kept, images: (closed_convolution(images, kept[1]), correlation(images, kept[0])),
)
correlation.defvjp(
    lambda images, cotangents: (correlation(images, cotangents), (images, cotangents)),
    lambda kept, kernel: (transposed_convolution(kept[1], kernel), closed_convolution(kept[0], kernel)),
)

FORMS: dict[str, Callable[[Images, Kernel], Images]] = {
    "lax": lax_convolution,
    "shifts": shifted_products,
    "patches": patch_product,
    "closed": closed_convolution,
    "winograd": winograd_convolution,
}

#: What was fastest in compiled loops, by back end (docs/performance.md).
FASTEST: dict[str, Convolution] = {"cpu": "winograd"}


def fastest_form(backend: str | None = None, *, adapted: bool = False) -> Convolution:
    """The form of the convolution to use on a back end; JAX's default one if None.

    Where nothing was measured yet, and for networks whose weights each task adapts by a gradient step, that is one
    product with patches: it batches well everywhere.
    """
    return "patches" if adapted else FASTEST.get(backend or jax.default_backend(), "patches")


#: Bits that are left of a factor's mantissa; sums are float32 in any case.
_MANTISSAS: dict[Precision, int] = {"tensorfloat32": 10, "bfloat16": 7}
#: JAX's names of what GPUs have units for.
ON_GPUS: dict[Precision, str] = {
    "float32": "highest",
    "tensorfloat32": "TF32_TF32_F32",
    "bfloat16": "BF16_BF16_F32",
}


def convolve(
    images: Images, kernel: Kernel, form: Convolution, precision: Precision = "float32", backend: str | None = None
) -> Images:
    """The convolution in one of its forms, its factors, forwards and backwards, with as many bits as said.

    GPUs multiply faster with fewer bits. Elsewhere factors are rounded, which costs time, and shows what fewer bits do
    to learning.

    Args:
        images: ``[..., height, width, inputs]``.
        kernel: ``[3, 3, inputs, outputs]``.
        form: a name in `FORMS`.
        precision: of the factors.
        backend: JAX's default one if None.
    """
    if (backend or jax.default_backend()) == "gpu":
        with jax.default_matmul_precision(ON_GPUS[precision]):  # what is differentiated inherits it
            return FORMS[form](images, kernel)
    if precision == "float32":
        return FORMS[form](images, kernel)
    bits = _MANTISSAS[precision]
    return _rounding_cotangents(FORMS[form](_rounded(images, bits), _rounded(kernel, bits)), bits)


def _rounded(numbers: Array, bits: int) -> Array:
    return jax.lax.reduce_precision(numbers, exponent_bits=8, mantissa_bits=bits)


@functools.partial(jax.custom_vjp, nondiff_argnums=(1,))
def _rounding_cotangents(images: Images, bits: int) -> Images:
    """The images as they are; what comes back through them is rounded, being a factor of the gradients' products."""
    return images


_rounding_cotangents.defvjp(
    lambda images, bits: (images, None), lambda bits, _, cotangents: (_rounded(cotangents, bits),)
)


def _windows(images: Images) -> list[Images]:
    """The images seen from each cell's nine neighbours, row by row; zero beyond the border."""
    height, width = images.shape[-3:-1]
    padded = jnp.pad(images, [(0, 0)] * (images.ndim - 3) + [(1, 1), (1, 1), (0, 0)])
    return [padded[..., row : row + height, column : column + width, :] for row in range(3) for column in range(3)]


def _row_products(images: Images, kernel: Kernel) -> Images:
    """One product of three column shifts with all three rows of the kernel; its thirds are shifted and added."""
    inputs, outputs = kernel.shape[2:]
    columns = _shifted(images, -2, (-1, 0, 1))
    products = columns @ kernel.transpose(1, 2, 0, 3).reshape(3 * inputs, 3 * outputs)
    above, here, below = jnp.split(products, 3, axis=-1)
    return _shifted(above, -3, (-1,)) + here + _shifted(below, -3, (1,))


def _shifted(images: Images, axis: int, steps: tuple[int, ...]) -> Images:
    """What lies so many cells further along an axis, for each step, side by side on the last axis."""
    margins = [(0, 0)] * images.ndim
    margins[axis] = (1, 1)
    padded, length = jnp.pad(images, margins), images.shape[axis]
    parts = [jax.lax.slice_in_dim(padded, 1 + step, 1 + step + length, axis=images.ndim + axis) for step in steps]
    return jnp.concatenate(parts, axis=-1)
