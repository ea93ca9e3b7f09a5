"""Random scenes with textures, depth and perspective, of one structure so as to share programs."""

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
"""A small canvas, no multiple of a tile; other rates and origins replace its own."""

COUNT = 20
"""Number of triangles in each scene."""

SIZES = ((5, 3), (1, 7), (7, 7), (1, 1), (8, 16), (6, 1))
"""Height and width of each texture of a scene: odd, one row, one column, one texel, even."""


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
    """`COUNT` random triangles, large to small, one in seven untextured, with uv beyond 0..1.

    - `colors`: corners and channels; `texels`: channels of the textures, None for none.
    - `reach`: greatest extent of uv as a power of two: 0 spans a few textures, 3 some dozen.

    Corners are multiples of 1/64 px, which every grid here represents.
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
    """The package's scene of a soup."""

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
    """The package's filter of a sampler."""
    return sr.Filter(
        pixel=sampler.pixel,  # pyright: ignore
        level=sampler.level,  # pyright: ignore
        anisotropy=sampler.anisotropy,
        lod_bias=sampler.lod_bias,
    )


def plan_of(scene: sr.Scene, on: Canvas, sampler: Sampler, shading: str = "sample") -> sr.Plan:
    """A plan for any `COUNT` triangles in the band, so that scenes share a program."""
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
    """Scenes that need most: the largest triangles, and thin ones, several in most pixels."""
    top = np.linspace(-2, on.height, count)[:, None, None]
    thin = np.array([(-4, 0), (on.width + 4, 0), (on.width + 4, 3.5 * on.height / count)])
    return [*vast(on, count), (thin + [0, 1] * top).astype(np.float32)]


def _with_corners(scene: sr.Scene, corners: np.ndarray) -> sr.Scene:
    """`scene` with other positions, and with equal depths, so that no triangle hides another."""
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
    """The package's image of a soup."""
    scene = scene_of(soup, sampler, dtype)
    image, overflow = sr.render_checked(scene, plan_of(scene, on, sampler, shading))
    assert not bool(overflow), "overflow"
    assert image.dtype == dtype
    return np.asarray(image)


def assert_close(
    image: np.ndarray, expected: Drawing, atol: float = 2e-6, message: str = "", **margins: float
) -> None:
    """Assert equality in every certain pixel (`Drawing.certain`), and that most pixels are."""
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
