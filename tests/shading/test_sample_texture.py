"""`sample_texture` equals the texture oracle, and its gradient equals finite differences."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.shading import filter_of, images_of
from ..oracles.texture import Sampler, chain, sample

POINTS = 400

SAMPLERS = [
    Sampler(pixel, level, anisotropy, 0.25, border, addressing)
    for pixel in ("nearest", "bilinear")
    for level in ("zero", "nearest", "linear")
    for anisotropy in (1, 3)
    for border in ("clamp", "repeat")
    for addressing in ("half_texel", "corners")
]

QUICK = [Sampler("bilinear", "linear", 3, 0.25), Sampler("nearest", "nearest", border="repeat")]

sample_texture = eqx.filter_jit(sr.sample_texture)


def build(sampler: Sampler, channels: int, dtype: Any = np.float32) -> sr.TexturePyramid:
    return sr.TexturePyramid.build(
        [image.astype(dtype) for image in images_of(channels)],
        border=sampler.border,  # pyright: ignore
        addressing=sampler.addressing,  # pyright: ignore
    )


def points_of(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Seeded points: (u, v) beyond 0..1, footprints, and texture indices.

    Footprints range from much less than a texel to the whole image.
    """
    rng = np.random.default_rng(seed)
    uv = rng.uniform(-1.2, 2.2, (POINTS, 2))
    size = 2.0 ** rng.uniform(-7, 1, (POINTS, 1, 1))
    footprint = rng.normal(size=(POINTS, 2, 2)) * size
    footprint[::20] = 0
    index = rng.integers(-1, len(images_of()), POINTS)
    return uv.astype(np.float32), footprint.astype(np.float32), index.astype(np.int32)


def expected_texels(
    sampler: Sampler, channels: int, uv: np.ndarray, footprint: np.ndarray, index: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Texels and margins by the oracle; texels are 1 for points without a texture."""
    texels, margin = np.ones((POINTS, 4)), np.full(POINTS, np.inf)
    for number, image in enumerate(images_of(channels)):
        chosen = index == number
        of_points = uv[chosen].astype(np.float64), footprint[chosen].astype(np.float64)
        texels[chosen], margin[chosen] = sample(chain(image), *of_points, sampler)
    return texels[:, :channels], margin


@pytest.mark.parametrize(
    "sampler, channels",
    [*((sampler, 3) for sampler in QUICK), *(slowly(sampler, 4) for sampler in SAMPLERS)],
)
def test_texels_equal_the_oracle(sampler, channels):
    uv, footprint, index = points_of()
    texels = sample_texture(
        build(sampler, channels), uv, footprint, filter_of(sampler), texture_index=index
    )
    expected, margin = expected_texels(sampler, channels, uv, footprint, index)
    # Rounding may change the number of probes where the ratio of the axes is near a jump.
    certain = margin > 2e-3
    assert certain.mean() > 0.95
    np.testing.assert_allclose(np.asarray(texels)[certain], expected[certain], atol=1e-5)


@pytest.mark.parametrize("size", (1, 3, 4))
def test_coordinates_just_below_an_integer_read_the_last_texel(size):
    """The fractional part of such a coordinate rounds to 1, a texel past the end of the image."""
    column = np.random.default_rng(size).random((size, 1, 3)).astype(np.float32)
    pyramid = sr.TexturePyramid.build([column], border="repeat")
    below = np.array([-1e-30, -1e-9, -3e-8, np.nextafter(np.float32(1), 0)], np.float32)
    uv = np.stack([np.full(4, 0.5), below], -1).astype(np.float32)
    footprint = np.zeros((4, 2, 2), np.float32)

    def read(pixel: Any, uv: Any) -> Any:
        return sample_texture(pyramid, uv, footprint, sr.Filter(pixel=pixel, level="zero"))

    np.testing.assert_array_equal(read("nearest", uv), np.tile(column[-1], (4, 1)))
    between = (column[0] + column[-1]) / 2
    np.testing.assert_allclose(read("bilinear", uv), np.tile(between, (4, 1)), atol=1e-6)
    slope = jax.jvp(lambda v: read("bilinear", v), (uv,), (np.array([[0, 1]] * 4, np.float32),))[1]
    wanted = np.tile(size * (column[0] - column[-1]), (4, 1))
    np.testing.assert_allclose(slope, wanted, atol=1e-5)


def test_leading_axes_one_index_and_defaults():
    textures = build(Sampler(), 3)
    uv = np.random.default_rng(0).random((4, 5, 2)).astype(np.float32)
    by_default = sample_texture(textures, uv)
    assert by_default.shape == (4, 5, 3)
    image = chain(images_of()[0])[0]
    expected, _ = sample([image], uv.reshape(-1, 2), np.zeros((20, 2, 2)), Sampler(level="zero"))
    np.testing.assert_allclose(by_default.reshape(-1, 3), expected[:, :3], atol=1e-6)
    without = sample_texture(textures, uv, texture_index=-1)
    np.testing.assert_array_equal(without, np.ones((4, 5, 3)))


@pytest.mark.parametrize(
    "sampler",
    [
        Sampler("bilinear", "linear", 3, border="repeat"),
        slowly(Sampler("bilinear", "linear", addressing="corners")),
        slowly(Sampler("bilinear", "nearest", 3)),
        slowly(Sampler("nearest", "linear")),
    ],
)
def test_derivatives_equal_differences(sampler, float64):
    """The jvp equals central differences, and the vjp is its transpose, for each input.

    The inputs are (u, v), the footprint and the texels. Points are left out where the lookup jumps
    within about a thousand steps of the difference.
    """
    textures = build(sampler, 3, np.float64)
    uv, footprint, index = points_of(1)
    filter = filter_of(sampler)
    arguments = {
        "uv": uv.astype(np.float64),
        "footprint": footprint.astype(np.float64),
        "texels": np.asarray(textures.texels),
    }

    def texels_of(arguments: dict[str, Any]) -> Any:
        pyramid = eqx.tree_at(lambda p: p.texels, textures, arguments["texels"])
        uv, footprint = arguments["uv"], arguments["footprint"]
        return sr.sample_texture(pyramid, uv, footprint, filter, texture_index=index)

    draw = jax.jit(texels_of)
    jvp = jax.jit(lambda direction: jax.jvp(texels_of, (arguments,), (direction,))[1])
    vjp = jax.jit(lambda weight: jax.vjp(texels_of, arguments)[1](weight)[0])
    rng = np.random.default_rng(2)
    weight = jnp.asarray(rng.normal(size=(POINTS, 3)))
    gradient = vjp(weight)
    step = 1e-7
    _, margin = expected_texels(sampler, 3, uv, footprint, index)
    for name, value in arguments.items():
        # The lookup is not differentiable at an empty footprint, so zero entries do not move.
        random = rng.normal(size=value.shape)
        random = np.where(value == 0, 0, random) if name == "footprint" else random
        direction = {key: jnp.zeros(entry.shape) for key, entry in arguments.items()}
        direction[name] = jnp.asarray(random)
        tangent = np.asarray(jvp(direction))
        ends = [draw({**arguments, name: value + sign * step * random}) for sign in (1, -1)]
        difference = np.asarray(ends[0] - ends[1]) / (2 * step)
        certain = margin > 1e-4
        assert certain.mean() > 0.5
        # The filter "nearest" does not depend on (u, v), nor a level of zero on the footprint.
        assert name != "texels" or np.any(tangent[certain])
        np.testing.assert_allclose(
            tangent[certain], difference[certain], rtol=1e-5, atol=2e-6, err_msg=name
        )
        pulled = float(np.vdot(np.asarray(gradient[name]), random))
        assert pulled == pytest.approx(float(np.vdot(tangent, weight)), rel=1e-9, abs=1e-9)


def test_wrong_shapes_are_refused_in_one_line():
    textures = build(Sampler(), 3)
    uv = np.zeros((4, 2), np.float32)
    for given_uv, footprint, message in (
        (np.zeros((4, 3), np.float32), None, r"`uv` must be \[\.\.\., 2\]; got \(4, 3\)"),
        (uv, np.zeros((4, 2), np.float32), r"`footprint` must be \[\.\.\., 2, 2\] like `uv`"),
    ):
        with pytest.raises(ValueError, match=message) as raised:
            sr.sample_texture(textures, given_uv, footprint)
        assert "\n" not in str(raised.value)


def test_other_arguments_are_refused_in_one_line():
    textures = build(Sampler(), 3)
    uv = np.zeros((4, 2), np.float32)
    read = inspect.unwrap(sr.sample_texture)  # Without the check of annotations.
    for given, message in (
        ({"textures": np.zeros((4, 4, 3))}, r"`textures` must come from TexturePyramid\.build"),
        ({"filter": "bilinear"}, r"`filter` must be Filter\(\.\.\.\); got 'bilinear'"),
        ({"texture_index": 0.5}, "`texture_index` must be integers; got float64"),
        ({"texture_index": textures.count}, r"`texture_index` must be in -1\.\."),
        ({"texture_index": -2}, r"`texture_index` must be in -1\.\."),
        ({"texture_index": np.zeros(3, int)}, r"like the points of `uv`, \(4,\); got \(3,\)"),
    ):
        with pytest.raises(ValueError, match=message) as raised:
            read(**({"textures": textures, "uv": uv} | given))
        assert "\n" not in str(raised.value)
