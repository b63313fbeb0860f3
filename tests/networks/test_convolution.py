"""The forms of the convolution: sums by hand, and lax.conv as the referee of values, first and second derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from upslope.networks.convolution import convolve, fastest_form
from upslope.networks.convolution_forms import FORMS, lax_convolution

NAMES = sorted(FORMS)
SHAPES = [(2, 5, 6, 3, 4), (1, 1, 1, 2, 3), (3, 8, 4, 1, 2), (2, 2, 2, 4, 1), (1, 9, 3, 2, 2), (1, 13, 2, 3, 3)]


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def images_and_kernel(shape, seed=0):
    batch, height, width, inputs, outputs = shape
    keys = jax.random.split(jax.random.key(seed), 2)
    return jax.random.normal(keys[0], (batch, height, width, inputs)), jax.random.normal(
        keys[1], (3, 3, inputs, outputs)
    )


def by_hand(images, kernel):
    batch, height, width, _ = images.shape
    result = np.zeros((batch, height, width, kernel.shape[-1]))
    for row in range(height):
        for column in range(width):
            for down in (-1, 0, 1):
                for right in (-1, 0, 1):
                    if 0 <= row + down < height and 0 <= column + right < width:
                        result[:, row, column] += images[:, row + down, column + right] @ kernel[down + 1, right + 1]
    return result


def in_form(form):
    """The operation in one of its forms; `lax_convolution` itself, differentiated by JAX, is the referee."""
    return lambda images, kernel: convolve(images, kernel, form)


def derivatives(form, images, kernel):
    """First derivatives of something curved, and second ones along something curved again."""

    def first(images, kernel):
        return jax.grad(lambda *both: jnp.sum(jnp.sin(form(*both)) ** 2), (0, 1))(images, kernel)

    def curved(images, kernel):
        return sum(jnp.sum(jnp.cos(part)) for part in first(images, kernel))

    return jax.jit(lambda *both: (first(*both), jax.grad(curved, (0, 1))(*both)))(images, kernel)


@pytest.mark.parametrize("form", NAMES)
@pytest.mark.parametrize("shape", SHAPES)
def test_values_by_hand(form, shape):
    images, kernel = images_and_kernel(shape)
    np.testing.assert_allclose(
        jax.jit(in_form(form))(images, kernel), by_hand(np.asarray(images), np.asarray(kernel)), atol=1e-12
    )


@pytest.mark.parametrize("form", NAMES)
@pytest.mark.parametrize("shape", SHAPES[:2])
def test_first_and_second_derivatives_are_those_of_lax(form, shape):
    both = images_and_kernel(shape)
    for ours, theirs in zip(
        jax.tree.leaves(derivatives(in_form(form), *both)), jax.tree.leaves(derivatives(lax_convolution, *both)),
        strict=True,
    ):  # fmt: skip
        assert np.abs(theirs).max() > 1e-2, "there is something to compare"
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("form", NAMES)
def test_third_derivatives_too(form):
    images, kernel = images_and_kernel((1, 3, 2, 2, 2))

    def third(form):
        def curved(image_share, kernel_share):
            return jnp.sum(jnp.sin(form(image_share * images, kernel_share * kernel)))

        return jax.jit(jax.grad(jax.grad(jax.grad(curved, 0), 1), 0))(jnp.asarray(0.7), jnp.asarray(1.3))

    np.testing.assert_allclose(third(in_form(form)), third(lax_convolution), rtol=1e-9)


@pytest.mark.parametrize("form", NAMES)
def test_any_leading_axes_and_none(form):
    images, kernel = images_and_kernel((6, 4, 3, 2, 5))
    results = jax.jit(in_form(form))
    flat = results(images, kernel)
    np.testing.assert_allclose(results(images.reshape(2, 3, 4, 3, 2), kernel).reshape(flat.shape), flat, atol=1e-12)
    np.testing.assert_allclose(results(images[0], kernel), flat[0], atol=1e-12)


@pytest.mark.parametrize("form", NAMES)
def test_mapped_over_images_and_over_weights(form):
    images, _ = images_and_kernel((3, 4, 3, 2, 5))
    kernels = jax.random.normal(jax.random.key(7), (3, 3, 3, 2, 5))

    def gradients(form):
        shared = jax.grad(lambda kernel: jnp.sum(jnp.sin(jax.vmap(form, (0, None))(images, kernel))))(kernels[0])
        own = jax.grad(lambda kernels: jnp.sum(jnp.sin(jax.vmap(form)(images, kernels))))(kernels)
        return shared, own

    gradients = jax.jit(gradients, static_argnums=0)
    for ours, theirs in zip(gradients(in_form(form)), gradients(lax_convolution), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("form", NAMES)
@pytest.mark.parametrize("size", [8, 10])
def test_single_precision_at_the_size_of_the_paper_s_maps(form, size):
    """Rounding grows with the channels, and Winograd's sums more than others: by some millionths of the largest."""
    images, kernel = (part.astype(jnp.float32) for part in images_and_kernel((4, size, size, 32, 32)))
    kernel = kernel / np.sqrt(9 * 32).astype(np.float32)  # results then are as large as the images

    def all_of(form):
        def loss(images, kernel):
            results = form(images, kernel)
            return jnp.sum(jnp.sin(results) ** 2), results

        slopes, results = jax.jit(jax.grad(loss, (0, 1), has_aux=True))(images, kernel)
        return results, *slopes

    for ours, theirs in zip(all_of(in_form(form)), all_of(lax_convolution), strict=True):
        assert ours.dtype == jnp.float32
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=5e-6 * np.abs(theirs).max())


def test_the_form_is_chosen_by_back_end():
    assert fastest_form("cpu") == "winograd"
    assert fastest_form("never heard of") == "patches"
    assert fastest_form() in FORMS


class TestPrecision:
    """On a CPU factors are rounded: what they then give is known to the last bit of a float64."""

    @pytest.mark.parametrize(("precision", "bits"), [("tensorfloat32", 10), ("bfloat16", 7)])
    def test_one_product_is_that_of_rounded_factors(self, precision, bits):
        image, kernel = jnp.full((1, 1, 1, 1), np.pi), jnp.zeros((3, 3, 1, 1)).at[1, 1].set(np.e)

        def rounded(number):
            return round(number * 2 ** (bits - 1)) / 2 ** (bits - 1)  # π and e lie between 2 and 4

        value, gradients = jax.value_and_grad(
            lambda *both: jnp.sum(np.sqrt(5) * convolve(*both, "patches", precision)), (0, 1)
        )(image, kernel)
        assert float(value) == pytest.approx(np.sqrt(5) * rounded(np.pi) * rounded(np.e), rel=1e-15)
        # The cotangent √5 is a factor too, and what comes back through a rounding is rounded.
        assert float(gradients[0].ravel()[0]) == pytest.approx(rounded(np.sqrt(5)) * rounded(np.e), rel=2.0**-bits)
        assert float(gradients[1][1, 1, 0, 0]) == pytest.approx(rounded(np.sqrt(5)) * rounded(np.pi), rel=2.0**-bits)

    @pytest.mark.parametrize("form", NAMES)
    @pytest.mark.parametrize(("precision", "distance"), [("tensorfloat32", 2.0**-9), ("bfloat16", 2.0**-6)])
    def test_values_and_derivatives_lie_near_the_exact_ones(self, form, precision, distance):
        images, kernel = images_and_kernel((2, 5, 6, 3, 4))
        images = images.astype(jnp.float32)
        kernel = kernel.astype(jnp.float32)

        def both(precision):
            def loss(images, kernel):
                return jnp.sum(convolve(images, kernel, form, precision) ** 2)

            return jax.value_and_grad(loss, (0, 1))(images, kernel)

        (exact, exact_slopes), (value, slopes) = both("float32"), both(precision)
        assert value != exact
        assert float(value) == pytest.approx(float(exact), rel=2 * distance)
        for slope, exact_slope in zip(slopes, exact_slopes, strict=True):
            off = jnp.linalg.norm(slope - exact_slope) / jnp.linalg.norm(exact_slope)
            assert 0 < off < 2 * distance

    @pytest.mark.parametrize(
        ("precision", "said"),
        [("float32", "HIGHEST"), ("tensorfloat32", "tf32"), ("bfloat16", "bf16")],
    )
    def test_gpus_get_the_precision(self, precision, said):
        images, kernel = (part.astype(jnp.float32) for part in images_and_kernel((2, 5, 6, 3, 4)))

        def loss(images, kernel):
            return jnp.sum(convolve(images, kernel, "patches", precision, backend="gpu") ** 2)

        lowered = jax.jit(jax.grad(loss, (0, 1))).trace(images, kernel).lower(lowering_platforms=("cuda",))
        products = [line for line in lowered.as_text().splitlines() if "dot_general" in line]
        assert len(products) >= 3
        assert all(said in line for line in products)


def passes(jaxpr):
    """The shapes of the images that each convolution and correlation of a program takes."""
    return [eqn.invars[0].aval.shape for eqn in jaxpr.eqns if eqn.primitive.name.endswith("_3x3")]


class TestMapping:
    """What is mapped over images is one operation on all of them: mapped part by part it takes twice as long."""

    def test_over_images_forwards_and_backwards(self):
        images, kernel = images_and_kernel((6, 4, 3, 2, 5))

        def loss(kernel):
            by_two = jax.vmap(jax.vmap(in_form("winograd"), (0, None)), (0, None))
            return jnp.sum(jnp.sin(by_two(images.reshape(2, 3, 4, 3, 2), kernel)))

        assert passes(jax.make_jaxpr(jax.grad(loss))(kernel)) == [(2, 3, 4, 3, 2)] * 2

    def test_along_any_axis(self):
        images, kernel = images_and_kernel((6, 4, 3, 2, 5))
        mapped = jax.vmap(in_form("winograd"), (2, None), 1)(jnp.moveaxis(images, 0, 2), kernel)
        np.testing.assert_allclose(jnp.moveaxis(mapped, 1, 0), convolve(images, kernel, "lax"), atol=1e-12)

    def test_gradients_of_single_images(self):
        images, kernel = images_and_kernel((4, 4, 3, 2, 5))

        def gradients(form):
            return jax.vmap(jax.grad(lambda kernel, image: jnp.sum(jnp.sin(form(image, kernel)))), (None, 0))

        np.testing.assert_allclose(
            gradients(in_form("winograd"))(kernel, images), gradients(lax_convolution)(kernel, images), atol=1e-9
        )

    def test_forward_mode(self):
        both = images_and_kernel((2, 5, 6, 3, 4))
        along = images_and_kernel((2, 5, 6, 3, 4), seed=1)
        for ours, theirs in zip(
            jax.jvp(in_form("winograd"), both, along), jax.jvp(lax_convolution, both, along), strict=True
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)
