"""The 3 × 3 convolution (stride 1, SAME padding) in equivalent forms with very different speeds.

Each is a plain function of images ``[..., height, width, inputs]`` and a kernel ``[3, 3, inputs, outputs]``;
`upslope.networks.convolution` differentiates and batches them. ``python -m benchmarks.meta_gradient`` measures them.
"""

import functools
from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Images = Float[Array, "*batch height width _"]
Kernel = Float[Array, "3 3 inputs outputs"]
Convolution = Literal["lax", "shifts", "patches", "rows", "winograd"]


def lax_convolution(images: Images, kernel: Kernel) -> Images:
    """XLA's own: on CPU many times slower inside compiled loops, and even slower if each task has its own weights."""
    flat = images.reshape(-1, *images.shape[-3:])
    result = jax.lax.conv_general_dilated(flat, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))
    return result.reshape(*images.shape[:-1], kernel.shape[-1])


def shifted_products(images: Images, kernel: Kernel) -> Images:
    """The sum of nine matrix products with shifted images."""
    windows = _windows(images)
    products = [window @ kernel[divmod(index, 3)] for index, window in enumerate(windows)]
    return jnp.sum(jnp.stack(products), axis=0)


def patch_product(images: Images, kernel: Kernel) -> Images:
    """One matrix product with the neighbourhoods of all cells."""
    return jnp.concatenate(_windows(images), axis=-1) @ kernel.reshape(-1, kernel.shape[-1])


def row_products(images: Images, kernel: Kernel) -> Images:
    """One product of three column shifts with all three rows of the kernel, whose thirds are then shifted and added."""
    inputs, outputs = kernel.shape[2:]
    products = _neighbours(images) @ kernel.transpose(1, 2, 0, 3).reshape(3 * inputs, 3 * outputs)
    return _added_up(products, -3)


def winograd_convolution(images: Images, kernel: Kernel) -> Images:
    """Winograd's algorithm along the columns, with about half the arithmetic, and direct convolution along the rows.

    F(m, 3) computes m neighbouring results of a filter with three taps with m + 2 products instead of 3·m, from the
    values of polynomials at m + 1 points and infinity (Lavin & Gray, Fast Algorithms for Convolutional Neural Networks,
    2016).
    """
    height, width, inputs = images.shape[-3:]
    tile = _tile(height)
    tiles, (to_points, taps_to_points, from_points) = -(-height // tile), _MATRICES[tile]
    flat = images.reshape(-1, height, width, inputs)
    padded = jnp.pad(flat, ((0, 0), (1, tiles * tile - height + 1), (0, 0), (0, 0)))
    rows = [padded[:, row : row + (tiles - 1) * tile + 1 : tile] for row in range(tile + 2)]
    at_points = jnp.stack(_combined(rows, to_points))
    taps = jnp.tensordot(jnp.asarray(taps_to_points, kernel.dtype), kernel, 1)
    results = jnp.stack(_combined(list(_along_rows(at_points, taps)), from_points), axis=2)
    return results.reshape(-1, tiles * tile, *results.shape[3:])[:, :height].reshape(*images.shape[:-1], -1)


FORMS: dict[Convolution, Callable[[Images, Kernel], Images]] = {
    "lax": lax_convolution,
    "shifts": shifted_products,
    "patches": patch_product,
    "rows": row_products,
    "winograd": winograd_convolution,
}


def _along_rows(
    images: Float[Array, "n *batch width inputs"], taps: Float[Array, "n 3 inputs outputs"]
) -> Float[Array, "n *batch width outputs"]:
    """Convolutions along one axis, each with its own three taps; the smaller of inputs and outputs is tripled."""
    count, _, inputs, outputs = taps.shape
    if inputs < outputs:
        return _products(_neighbours(images), taps.reshape(count, 3 * inputs, outputs))
    return _added_up(_products(images, taps.transpose(0, 2, 1, 3).reshape(count, inputs, 3 * outputs)), -2)


def _products(
    images: Float[Array, "n *batch inputs"], matrices: Float[Array, "n inputs outputs"]
) -> Float[Array, "n *batch outputs"]:
    """Matrix products of all cells at once."""
    flat = images.reshape(images.shape[0], -1, images.shape[-1])
    return (flat @ matrices).reshape(*images.shape[:-1], matrices.shape[-1])


def _windows(images: Images) -> list[Images]:
    """The nine shifted images, one for each neighbour of a cell, row by row; zero beyond the border."""
    height, width = images.shape[-3:-1]
    padded = jnp.pad(images, [(0, 0)] * (images.ndim - 3) + [(1, 1), (1, 1), (0, 0)])
    return [padded[..., row : row + height, column : column + width, :] for row in range(3) for column in range(3)]


def _neighbours(images: Images) -> Images:
    """The previous, current and next cell along the rows, concatenated on the last axis."""
    return jnp.concatenate([_shifted(images, -2, step) for step in (-1, 0, 1)], axis=-1)


def _shifted(images: Images, axis: int, step: int) -> Images:
    """The values ``step`` cells further along an axis; zero beyond the border."""
    margins = [(0, 0)] * images.ndim
    margins[axis] = (1, 1)
    length = images.shape[axis]
    return jax.lax.slice_in_dim(jnp.pad(images, margins), 1 + step, 1 + step + length, axis=images.ndim + axis)


def _added_up(products: Images, axis: int) -> Images:
    """The sum of the products with three taps ``[..., 3 · outputs]``, each shifted to its place along an axis."""
    before, here, after = jnp.split(products, 3, axis=-1)
    return _shifted(before, axis, -1) + here + _shifted(after, axis, 1)


def _combined(parts: list[Array], weights: np.ndarray) -> list[Array]:
    """Weighted sums of arrays, one for each row of weights. Terms with weight zero are skipped."""
    products = ([float(weight) * parts[index] for index, weight in enumerate(row) if weight] for row in weights)
    return [functools.reduce(jnp.add, row) for row in products]


def _tile(height: int) -> int:
    """The tile that needs the fewest products for a column: 8 cells are two tiles of 4, 10 are two of 5."""
    return min(_MATRICES, key=lambda tile: -(-height // tile) * (tile + 2))


def _matrices(points: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F(m, 3) for m + 1 points: matrices from inputs to points, from taps to points, and from products to results."""
    others = [np.delete(points, index) for index in range(len(points))]
    to_points = [np.append(np.poly(rest)[::-1], 0) for rest in others] + [np.poly(points)[::-1]]
    taps = [point ** np.arange(3) / np.prod(point - rest) for point, rest in zip(points, others, strict=True)]
    from_points = np.vander(points, len(points) - 1, increasing=True).T
    infinity = np.eye(len(points) - 1)[:, -1:]
    return np.array(to_points), np.array([*taps, [0, 0, 1]]), np.hstack([from_points, infinity])


#: The matrices by tile. Points that are small powers of two keep rounding errors small.
_MATRICES = {4: _matrices((0.0, 1.0, -1.0, 2.0, -2.0)), 5: _matrices((0.0, 1.0, -1.0, 2.0, -2.0, 0.5))}
