"""Check that the methods of `traversal` agree on the same scenes, then time them."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import softras2d as sr
from softras2d.geometry.canvas_grid import Grid

from ..common.scenes import Soup, random_soup
from ..common.timing import interleave
from ..hard_speed import ours
from . import traversal
from .cases import with_overdraw

# Methods by their names in the figure and the tables.
LOOPS: dict[str, Callable[..., None]] = {
    "bounding box, by columns": traversal.box_by_columns,
    "bounding box, by rows": traversal.box_by_rows,
    "bounding box, one by one": traversal.box_one_by_one,
    "early exit per row": traversal.early_exit,
    "spans": traversal.spans,
    "bit masks": traversal.bit_masks,
    "tile lists": traversal.tile_lists,
}
COUNTED, OURS = "tile lists, counted", "softras2d"
SET_UP, RESOLVE = "set-up alone", "resolve alone"
YARDSTICK = "bounding box, by rows"
TOLERANCE = 2e-6
_NO_TRIANGLE = 2**17
"""A number above every index; an index divided by it is a colour below 1, exact in float32."""


def scenes(quick: bool) -> Iterator[tuple[str, Soup]]:
    """Flat opaque scenes by name: three scenes, or one small scene if `quick`."""
    if quick:
        yield "diagonal slivers", slivers(60, 128)
        return
    yield "large triangles", with_overdraw(random_soup(100, 512), 20)
    yield "small triangles", with_overdraw(random_soup(100_000, 512), 5)
    yield "diagonal slivers", slivers(1000, 512)


def slivers(count: int, size: int, seed: int = 0) -> Soup:
    """Triangles of half the canvas by 1/512 of it, within 10 degrees of a diagonal."""
    soup = random_soup(count, size, seed=seed)
    rng = np.random.default_rng(seed)
    centre = rng.random((count, 1, 2))
    diagonal = rng.choice([0.25, 0.75], count) * np.pi
    turn = diagonal + np.deg2rad(rng.uniform(-10, 10, count))
    along = np.stack([np.cos(turn), np.sin(turn)], -1)[:, None] / 4
    across = along[..., ::-1] * [-1, 1] / 256
    corners = (centre + np.concatenate([-along, along - across, along + across], 1)) * size
    return replace(soup, corners=corners.astype(np.float32))


class Table(NamedTuple):
    """Arrays that the loops of a scene share (see `traversal`); `owner` and `image` are results."""

    soup: Soup
    bits: int
    colors: NDArray[np.float32]
    owner: NDArray[np.int32]
    image: NDArray[np.float32]

    @staticmethod
    def of(soup: Soup) -> "Table":
        side = soup.size * traversal.RATE
        return Table(
            soup,
            Grid.for_canvas(soup.size, soup.size, traversal.RATE).bits,
            np.ascontiguousarray(soup.colors[:, 0, :3]),
            np.empty((side, side), np.int32),
            np.empty((soup.size, soup.size, 3), np.float32),
        )

    def shapes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return traversal.set_up(self.soup.corners, self.bits, self.soup.size)

    def find(self, loop: Callable[..., None]) -> NDArray[np.int32]:
        """The triangle in front at every sample, by one of `LOOPS`."""
        self.owner.fill(-1)
        loop(*self.shapes(), self.owner)
        return self.owner

    def resolve(self) -> NDArray[np.float32]:
        traversal.resolve(self.owner, self.colors, self.soup.background, self.image)
        return self.image

    def count(self) -> NDArray[np.float32]:
        """The image by counted tile lists, without storing samples."""
        shapes = self.shapes()
        traversal.tile_lists_counted(*shapes, self.colors, self.soup.background, self.image)
        return self.image


def compare(name: str, soup: Soup, budget_s: float) -> list[dict[str, Any]]:
    """A row for each method of drawing the scene.

    `find_ms` is the time until the visible triangle of every sample is known. It includes
    `set_up_ms`, the time of edges and boxes. `resolve_ms` is the time of averaging the colours of
    the samples, which is the same for all loops. Methods that do both at once have
    only `find_ms`. Counts of samples belong to the scene, not to the method.
    """
    table = Table.of(soup)
    package = ours.softras2d(soup, traversal.RATE**2)
    check(table, package.image(package.draw()))
    counts = count_samples(table)
    calls: dict[str, Callable[[], object]] = {
        way: lambda loop=loop: table.find(loop) for way, loop in LOOPS.items()
    }
    calls |= {COUNTED: table.count, OURS: package.draw}
    calls |= {SET_UP: table.shapes, RESOLVE: table.resolve}
    times = interleave(calls, rounds=7, budget_s=budget_s)
    set_up, resolve = times.pop(SET_UP), times.pop(RESOLVE)
    return [
        {
            "scene": name,
            "triangles": soup.count,
            "size_px": soup.size,
            "way": way,
            "find_ms": measured.median,
            "least_find_ms": measured.least,
            "cpu_ms": measured.cpu,
            "set_up_ms": set_up.median if way != OURS else 0.0,
            "resolve_ms": resolve.median if way in LOOPS else 0.0,
            "calls": measured.calls,
            **counts,
        }
        for way, measured in times.items()
    ]


def check(table: Table, drawn: NDArray[np.float32]) -> None:
    """Raise `ValueError` unless all methods give the same visible triangle at every sample.

    `drawn` is the package's image. The samples of the package are drawn as pixels of a
    larger canvas, with the same grid and a colour for each triangle.
    """
    wanted = shown_by_package(table.soup)
    for way, loop in LOOPS.items():
        differing = int((table.find(loop) != wanted).sum())
        if differing:
            raise ValueError(f"{way!r} differs from the package at {differing} samples.")
    image = table.resolve().copy()
    for way, other in ((COUNTED, table.count()), (OURS, drawn)):
        error = np.abs(other - image).max()
        if error > TOLERANCE:
            raise ValueError(f"the image by {way!r} is off by {error:.1e}.")


def shown_by_package(soup: Soup) -> NDArray[np.int32]:
    """The triangle in front at every sample, -1 for none."""
    side = soup.size * traversal.RATE
    index = np.arange(soup.count, dtype=np.float32) / _NO_TRIANGLE
    scene = sr.Scene.from_soup(soup.corners * traversal.RATE, np.stack([index] * 3, -1))
    plan = sr.plan(scene, height=side, width=side, coverage=sr.Hard(samples=1))
    shown = np.asarray(sr.render(scene, plan))[..., 0] * _NO_TRIANGLE
    if (shown != np.round(shown)).any():
        raise ValueError("a sample shows a mixture of triangles.")
    return np.where(shown == _NO_TRIANGLE, -1, shown).astype(np.int32)


def count_samples(table: Table) -> dict[str, int]:
    """Samples in bounding boxes and in triangles, summed over triangles, and visible samples."""
    edges, boxes = table.shapes()
    sides = np.maximum(boxes[:, [1, 3]] - boxes[:, [0, 2]] + 1, 0)
    return {
        "boxed": int(sides.prod(1).sum()),
        "covered": int(traversal.count_covered(edges, boxes)),
        "shown": int((table.find(traversal.spans) >= 0).sum()),
    }
