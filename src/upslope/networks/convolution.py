"""The 3 × 3 convolution as two JAX operations with fast rules for differentiation and batching.

Convolving images with a kernel is bilinear. Its derivative with respect to the kernel correlates images with
cotangents, which is bilinear too. Its derivative with respect to the images is a convolution with the reversed kernel.
So the two operations are closed under differentiation of any order. Mapped over images, a convolution takes all of them
at once, which is up to twice as fast as mapping its parts. How it is computed is its form
(`upslope.networks.convolution_forms`).
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

from upslope.networks.convolution_forms import FORMS, Convolution, Images, Kernel

Precision = Literal["float32", "tensorfloat32", "bfloat16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)

#: The fastest form in compiled loops, by back end (docs/performance.md).
FASTEST: dict[str, Convolution] = {"cpu": "winograd"}


def fastest_form(backend: str | None = None) -> Convolution:
    """The form of the convolution to use on a back end; None means JAX's default back end.

    On back ends that were not measured this is one product with patches, which batches well everywhere.
    """
    return FASTEST.get(backend or jax.default_backend(), "patches")


def convolve(
    images: Images, kernel: Kernel, form: Convolution, precision: Precision = "float32", backend: str | None = None
) -> Images:
    """The convolution in one of its forms, with factors of the given precision, forwards and backwards.

    GPUs multiply faster with fewer bits. Elsewhere the factors are rounded. This takes time, but it shows the effect of
    fewer bits on learning.

    Args:
        images: ``[..., height, width, inputs]``.
        kernel: ``[3, 3, inputs, outputs]``.
        form: a name in `FORMS`.
        precision: the precision of the factors.
        backend: the back end; JAX's default one if None.
    """
    backend = backend or jax.default_backend()
    return _convolution.bind(images, kernel, form=form, precision=precision, backend=backend)


def _convolved(images: Images, kernel: Kernel, *, form: Convolution, precision: Precision, backend: str) -> Images:
    return _with_bits(FORMS[form], images, kernel, precision, backend)


def _correlated(images: Images, cotangents: Images, *, form: Convolution, precision: Precision, backend: str) -> Kernel:
    """The derivative of <cotangents, convolution(images, kernel)> with respect to the kernel: the transposed form."""

    def backwards(images: Images, cotangents: Images) -> Kernel:
        kernel = jax.ShapeDtypeStruct((3, 3, images.shape[-1], cotangents.shape[-1]), images.dtype)
        return jax.linear_transpose(functools.partial(FORMS[form], images), kernel)(cotangents)[0]

    return _with_bits(backwards, images, cotangents, precision, backend)


#: The number of bits that a factor's mantissa keeps. Sums are always in float32.
_MANTISSAS: dict[Precision, int] = {"tensorfloat32": 10, "bfloat16": 7}
#: JAX's names of the precisions for which GPUs have units.
ON_GPUS: dict[Precision, str] = {
    "float32": "highest",
    "tensorfloat32": "TF32_TF32_F32",
    "bfloat16": "BF16_BF16_F32",
}


def _with_bits(product: Callable[[Array, Array], Array], a: Array, b: Array, precision: Precision, backend: str) -> Any:
    """A bilinear function of two arrays, computed with the given precision."""
    if backend == "gpu":
        with jax.default_matmul_precision(ON_GPUS[precision]):
            return product(a, b)
    if precision != "float32":
        bits = _MANTISSAS[precision]
        a, b = (jax.lax.reduce_precision(array, exponent_bits=8, mantissa_bits=bits) for array in (a, b))
    return product(a, b)


def _turned(kernel: Kernel) -> Float[Array, "3 3 outputs inputs"]:
    """The kernel that maps cotangents of the results to cotangents of the images."""
    return kernel[::-1, ::-1].swapaxes(2, 3)


def _operation(
    name: str, function: Callable[..., Array], shape: Callable[[Any, Any], tuple[int, ...]], *, side_by_side: bool
) -> Primitive:
    """A JAX primitive of two arrays, computed by a function.

    Args:
        name: its name in JAX's messages.
        function: the function that computes it; the arrays may have any leading axes.
        shape: the shape of the result, from the two arrays.
        side_by_side: whether a map over the first array alone adds a leading axis to it. All other maps map the
            function's parts, as JAX does.
    """
    primitive = Primitive(name)

    def batched(arrays: tuple[Array, Array], axes: tuple[int | None, int | None], **settings: Any) -> tuple[Array, int]:
        if side_by_side and axes[0] is not None and axes[1] is None:
            images, shared = arrays
            return primitive.bind(jnp.moveaxis(images, axes[0], 0), shared, **settings), 0
        return jax.vmap(functools.partial(function, **settings), axes)(*arrays), 0

    primitive.def_impl(jax.jit(function, static_argnames=("form", "precision", "backend")))
    primitive.def_abstract_eval(lambda a, b, **settings: jax.core.ShapedArray(shape(a, b), a.dtype))
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=False))
    batching.primitive_batchers[primitive] = batched
    return primitive


_convolution = _operation(
    "convolution_3x3",
    _convolved,
    lambda images, kernel: (*images.shape[:-1], kernel.shape[-1]),
    side_by_side=True,
)
_correlation = _operation(
    "correlation_3x3",
    _correlated,
    lambda images, cotangents: (3, 3, images.shape[-1], cotangents.shape[-1]),
    side_by_side=False,
)
ad.defbilinear(
    _convolution,
    lambda cotangents, images, kernel, **settings: _convolution.bind(cotangents, _turned(kernel), **settings),
    lambda cotangents, images, kernel, **settings: _correlation.bind(images, cotangents, **settings),
)
ad.defbilinear(
    _correlation,
    lambda kernel, images, cotangents, **settings: _convolution.bind(cotangents, _turned(kernel), **settings),
    lambda kernel, images, cotangents, **settings: _convolution.bind(images, kernel, **settings),
)
