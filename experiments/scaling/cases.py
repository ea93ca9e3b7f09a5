"""The scenes whose cost is measured; each axis varies one size of a base scene."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..common.scenes import Soup, random_soup


@dataclass(frozen=True)
class Case:
    """Random triangles, and how they are drawn.

    - `kind`: as in `random_soup`.
    - `triangles`: number of triangles in each scene, on `size_px` x `size_px` pixels.
    - `overdraw`: summed area of the triangles over the area of the canvas.
    - `samples`: samples per pixel.
    - `batch`: number of scenes in one call, by `vmap`.
    """

    kind: str = "flat"
    triangles: int = 1000
    size_px: int = 512
    samples: int = 16
    overdraw: float = 5.0
    batch: int = 1


@dataclass(frozen=True)
class Axis:
    """Cases that are `base` with `field` set to each of `sizes`; `label` is for the figure."""

    name: str
    label: str
    field: str
    sizes: tuple[float, ...]
    base: Case = Case()

    def cases(self) -> Iterator[tuple[float, Case]]:
        for size in self.sizes:
            yield size, replace(self.base, **{self.field: size})


# Most sizes lie in the upper half of each range on a log scale, which is used for the fit.
_OVERDRAW = (1.0, 3.16, 10.0, 17.8, 31.6, 56.2, 100.0)
AXES = (
    Axis(
        "triangles",
        "triangles",
        "triangles",
        (100, 1_000, 10_000, 31_600, 100_000, 316_000, 1_000_000),
    ),
    Axis("canvas", "side of the canvas (px)", "size_px", (256, 512, 1024, 1448, 2048, 2896, 4096)),
    Axis("samples", "samples per pixel", "samples", (1, 4, 9, 16, 64, 256)),
    Axis(
        "overdraw",
        "overdraw, opaque (canvases)",
        "overdraw",
        _OVERDRAW,
        Case(size_px=256),
    ),
    Axis(
        "translucent overdraw",
        "overdraw, alpha 0.5 (canvases)",
        "overdraw",
        _OVERDRAW,
        Case(kind="flat_a50", size_px=256),
    ),
    Axis(
        "batch",
        "scenes a call",
        "batch",
        (1, 4, 16, 32, 64, 128, 256),
        Case(triangles=100, size_px=128),
    ),
)
QUICK = (
    Axis("triangles", "triangles", "triangles", (100, 1_000, 10_000), Case(size_px=256)),
    Axis("batch", "scenes a call", "batch", (1, 4), Case(triangles=100, size_px=64, samples=4)),
)
"""Few and small sizes, to check that everything runs."""


def soups(case: Case) -> list[Soup]:
    """The scenes of a batch, by seeds from 0."""
    return [
        with_overdraw(random_soup(case.triangles, case.size_px, case.kind, seed), case.overdraw)
        for seed in range(case.batch)
    ]


def with_overdraw(soup: Soup, overdraw: float) -> Soup:
    """Scale triangles about their centres, so that their areas add up to `overdraw` canvases.

    Areas outside the canvas count, so that the overdraw of pixels is a little lower.
    """
    corners = soup.corners.astype(np.float64)
    centre = corners.mean(1, keepdims=True)
    (ux, uy), (vx, vy) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = np.abs(ux * vy - uy * vx).sum() / 2
    grown = centre + (corners - centre) * np.sqrt(overdraw * soup.size**2 / area)
    return replace(soup, corners=grown.astype(np.float32))
