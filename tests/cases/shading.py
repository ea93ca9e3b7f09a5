"""Random scenes with textures, depth and perspective, and comparisons of images with the oracle.

Scenes with the same effects have one structure, so that they share programs.
"""

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..oracles.coverage import Canvas
from ..oracles.shading import Drawing, Soup
from ..oracles.texture import PLAIN, Sampler
from .scenes import vast

ON = Canvas(24, 28, rate=2)
"""A small canvas whose width is no multiple of a tile. Tests replace its rate and origin."""

COUNT = 20
"""Number of triangles in each scene."""

SIZES = ((5, 3), (1, 7), (7, 7), (1, 1), (8, 16), (6, 1))
"""Height and width of each texture, in texels: odd, one row, one column, one texel, even."""


def images_of(channels: int = 3, seed: int = 0, sizes: Any = SIZES) -> list[np.ndarray]:
    """Random textures in multiples of 1/256, float32."""
    rng = np.random.default_rng(seed)
    return [(rng.integers(0, 257, (*size, channels)) / 256).astype(np.float32) for size in sizes]


def soup_of(
    seed: int = 0,
    *,
    on: Canvas = ON,
    colors: tuple[int, int] = (3, 3),
    background: int = 3,
    texels: int | None = 3,
    depth: bool = False,
    perspective: bool = False,
    reach: float = 0.0,
) -> Soup:
    """`COUNT` random triangles, from large to small; about one in seven has no texture.

    - `colors`: number of colours per triangle, 1 or 3, and of channels, 3 or 4.
    - `background`: number of channels, 3 or 4.
    - `texels`: number of channels of the textures, or None for no textures.
    - `reach`: base-2 logarithm of the greatest extent of uv. At 0 a triangle spans a few copies of
      its texture, at 3 some dozen.

    Corners are multiples of 1/64 px, which the vertex grid of every canvas here contains.
    """
    rng = np.random.default_rng(seed)
    size = np.array([on.width, on.height])
    centre = rng.uniform(0, 1, (COUNT, 1, 2)) * size
    extent = np.geomspace(1.0, 0.2, COUNT)[:, None, None] * size
    low, high = on.band()
    corners = np.clip(centre + rng.uniform(-1, 1, (COUNT, 3, 2)) * extent, low, high)
    scale = 2.0 ** rng.uniform(-3, reach, (COUNT, 1, 1))
    uv = rng.uniform(0, 1, (COUNT, 1, 2)) + rng.uniform(-1, 1, (COUNT, 3, 2)) * scale
    index = np.arange(COUNT) % (len(SIZES) + 1) - 1
    textured = texels is not None
    return Soup(
        corners=(np.rint(corners * 64) / 64).astype(np.float32),
        colors=(rng.integers(0, 257, (COUNT, *colors)) / 256).astype(np.float32),
        background=np.array([0.25, 0.5, 0.75, 0.625][:background], np.float32),
        uv=uv.astype(np.float32) if textured else None,
        texture_index=rng.permutation(index).astype(np.int32) if textured else None,
        images=images_of(texels, seed) if texels is not None else None,
        depth=rng.uniform(0, 1, (COUNT, 3)).astype(np.float32) if depth else None,
        inverse_w=rng.uniform(0.3, 1.5, (COUNT, 3)).astype(np.float32) if perspective else None,
    )


def scene_of(soup: Soup, sampler: Sampler = PLAIN, dtype: Any = np.float32) -> sr.Scene:
    """Convert a soup to a scene of the package."""

    def cast(value: Any) -> Any:
        return None if value is None else np.asarray(value, dtype)

    textures = None
    if soup.images is not None:
        textures = sr.TexturePyramid.build(
            [cast(image) for image in soup.images],
            border=sampler.border,  # pyright: ignore
            addressing=sampler.addressing,  # pyright: ignore
        )
    return sr.Scene.from_soup(
        cast(soup.corners),
        cast(soup.colors),
        background=cast(soup.background),
        uv=cast(soup.uv),
        texture_index=soup.texture_index,
        textures=textures,
        depth=cast(soup.depth),
        inverse_w=cast(soup.inverse_w),
    )


def filter_of(sampler: Sampler) -> sr.Filter:
    """Convert a sampler to a filter of the package."""
    return sr.Filter(
        pixel=sampler.pixel,  # pyright: ignore
        level=sampler.level,  # pyright: ignore
        anisotropy=sampler.anisotropy,
        lod_bias=sampler.lod_bias,
    )


def plan_of(scene: sr.Scene, on: Canvas, sampler: Sampler, shading: str = "sample") -> sr.Plan:
    """A plan for as many triangles anywhere in the band, so that such scenes share a program."""
    count = scene.triangles.shape[0]
    filter = filter_of(sampler)
    coverage = sr.Hard(samples=on.samples, fill_rule=on.fill_rule, shading=shading)  # pyright: ignore
    demanding = [_with_corners(scene, corners) for corners in _demanding(on, count)]
    return sr.plan(
        [scene, *demanding],
        height=on.height,
        width=on.width,
        coverage=coverage,
        filter=filter,
        origin=on.origin,
    )


@functools.cache
def _demanding(on: Canvas, count: int) -> list[np.ndarray]:
    """Corners of scenes that need the greatest capacities.

    They have the largest triangles, and thin ones of which several meet in most pixels.
    """
    top = np.linspace(-2, on.height, count)[:, None, None]
    thin = np.array([(-4, 0), (on.width + 4, 0), (on.width + 4, 3.5 * on.height / count)])
    return [*vast(on, count), (thin + [0, 1] * top).astype(np.float32)]


def _with_corners(scene: sr.Scene, corners: np.ndarray) -> sr.Scene:
    """The scene with other positions, and with equal depths, so that no triangle hides another."""
    positions = jnp.asarray(corners.reshape(-1, 2), scene.positions.dtype)
    scene = eqx.tree_at(lambda s: s.positions, scene, positions)
    if scene.depth is None:
        return scene
    return eqx.tree_at(lambda s: s.depth, scene, jnp.zeros_like(scene.depth))


def render_soup(
    soup: Soup,
    on: Canvas = ON,
    sampler: Sampler = PLAIN,
    shading: str = "sample",
    dtype: Any = np.float32,
) -> np.ndarray:
    """The image of a soup that the package draws."""
    scene = scene_of(soup, sampler, dtype)
    image, overflow = sr.render_checked(scene, plan_of(scene, on, sampler, shading))
    assert not bool(overflow), "overflow"
    assert image.dtype == dtype
    return np.asarray(image)


def assert_close(
    image: np.ndarray, expected: Drawing, atol: float = 2e-6, message: str = "", **margins: float
) -> None:
    """Assert that images are close in all pixels of `Drawing.certain`, and that most are certain.

    In the other pixels, rounding may decide a jump: another texel, level or nearest triangle.
    """
    certain = expected.certain(**margins)
    assert certain.mean() > 0.95, f"{message}: only {certain.mean():.0%} of the pixels are certain"
    difference = np.abs(image - expected.image).max(axis=-1)
    difference = np.where(certain, difference, 0)
    # A NaN fails too.
    if not (difference <= atol).all():
        worst = np.nanargmax(np.where(np.isnan(difference), np.inf, difference))
        row, column = np.unravel_index(worst, difference.shape)
        raise AssertionError(
            f"{message}: {(~(difference <= atol)).sum()} of {certain.sum()} certain pixels differ; "
            f"the worst, row {row}, column {column}, is {image[row, column]} and should be "
            f"{expected.image[row, column]}."
        )
