"""Inspects a pixel: lists the triangles that cover it, its samples, and its value.

A view is the part of an enlarged drawing that a canvas shows (`view.py`). The window is a small
view around the inspected pixel. The layers of a sample are the triangles that cover it, nearest
first (`window_layers.py`). Analytic coverage, soft or by area, has one sample per pixel.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..color import premultiply, unpremultiply
from ..geometry.canvas_grid import Grid
from ..io.pixel_values import to_bytes
from ..planning.size_classes import pad
from ..scene import Scene
from .draw import Artist
from .exact_pixel import exact_pixel
from .settings import Settings
from .view import View
from .window_layers import (
    LAYERS,
    WindowLayers,
    cull,
    find_layers,
    on_host,
    with_flat_depth,
)

LENS = 11
"""Number of pixels along a side of the lens, the square of pixels that the inspector enlarges.

The inspected pixel is in its middle.
"""

_MOST_LAYERS = 128
"""Maximum number of layers that are composited at a sample."""

_REFERENCE_SAMPLES = 256
"""Samples per pixel of the reference value where `exact_pixel` returns None."""


class PixelReport(NamedTuple):
    """The values that the inspector shows for a pixel and for the pixels around it.

    - `facts`: values, layers and edges of the inspected pixel, for JSON (see `inspect_pixel`).
    - `samples`: straight RGBA of each sample of the lens, the square of pixels around the inspected
      one, as an image of samples. Under analytic coverage a pixel has one sample.
    """

    facts: dict[str, Any]
    samples: UInt8[np.ndarray, "rows columns 4"]


def inspect_pixel(
    artist: Artist, scene: Scene, view: View, settings: Settings, column: int, row: int
) -> PixelReport:
    """Report the values of one pixel of a view, and of the pixels around it.

    `column` and `row` are the pixel on the view's canvas. Only a small window, the lens, is drawn,
    on the fixed-point grid of the complete canvas. Its samples equal the samples of the canvas,
    except within two grid units of an edge that is cut at the guard band.

    The facts of the report are:

    - `column`, `row`: the inspected pixel.
    - `lens`, `rate`: number of pixels along a side of the lens, and of samples along a side of a
      pixel.
    - `value`: the colour with which the pixel is drawn, in 0..1, with straight alpha if the
      background has alpha.
    - `samples`: the nearest triangle (-1 for the background) and the colour of each sample of the
      pixel, row by row; empty under analytic coverage.
    - `layers`: the nearest triangles that cover the pixel, at most `most_layers` at each sample
      (`list_layers`). They may include triangles behind an opaque one. Under analytic coverage,
      they are the last triangles in draw order instead, even in a scene with depth.
    - `most_layers`: the largest number of triangles that can be listed at a sample or pixel.
    - `edges`: the corners of the triangles in `layers` (`_edges`).
    """
    center = LENS // 2
    window, nearby_scene, index = _window(scene, view, settings, column, row)
    bits = _grid_bits(view, settings)
    is_sampled = settings.coverage == "sampled"
    if is_sampled:
        layers, rate, is_complete = _sample_layers(artist, nearby_scene, window, settings, bits)
        colors = composite_samples(layers, np.asarray(scene.background, np.float64))
        value = unpremultiply(premultiply(colors[center, center]).mean(axis=0))
        if settings.shading == "pixel" or not is_complete:
            # The mean of these samples is not the pixel's value, so the pixel is rendered. In all
            # other cases, the mean saves compiling a program.
            image = artist.render(nearby_scene, window, settings, bits)[0]
            value = np.asarray(image)[center, center]
    else:
        # Drawn first, so that the plan is large enough for the layers too.
        colors = np.asarray(artist.render(nearby_scene, window, settings)[0])[:, :, None]
        layers = on_host(artist.with_plan(find_layers, nearby_scene, window, settings)[0])
        value, rate = colors[center, center, 0], 1
    facts = {
        "column": column,
        "row": row,
        "lens": LENS,
        "rate": rate,
        "value": value.tolist(),
        "samples": [
            {"triangle": _scene_index(triangle, index), "color": color.tolist()}
            for triangle, color in zip(
                layers.triangle[center, center, :, 0].tolist(), colors[center, center], strict=True
            )
        ]
        if is_sampled
        else [],
        "layers": list_layers(layers, index, center),
        "most_layers": layers.triangle.shape[3],
        "edges": _edges(nearby_scene, index, layers, window, center),
    }
    return PixelReport(facts, _in_rows(_as_rgba(colors), rate))


def reference_value(
    artist: Artist, scene: Scene, view: View, settings: Settings, column: int, row: int
) -> tuple[str, list[float]]:
    """Compute a more exact value of a pixel of a view, to compare the drawn value with.

    `column` and `row` are the pixel on the view's canvas. Returns how the value was computed,
    `"exact area"` or `"256 samples"`, and the value in 0..1, with straight alpha if the background
    has alpha. The value is the mean of the drawing over the square of the pixel (`exact_pixel`) or,
    where that is None, the value with 256 samples.
    """
    value = exact_pixel(scene, view.x + column, view.y + row)
    if value is not None:
        return "exact area", value
    window, nearby_scene, _ = _window(scene, view, settings, column, row)
    fine = replace(settings, coverage="sampled", samples=_REFERENCE_SAMPLES)
    bits = _grid_bits(view, fine)
    image = np.asarray(artist.render(nearby_scene, window, fine, bits)[0])
    return f"{_REFERENCE_SAMPLES} samples", image[LENS // 2, LENS // 2].tolist()


def _window(
    scene: Scene, view: View, settings: Settings, column: int, row: int
) -> tuple[View, Scene, Int[np.ndarray, " triangles"]]:
    """Return the lens around a pixel as a view, the triangles near the lens, and their indices.

    The lens is the square of `LENS` x `LENS` pixels around the pixel; `column` and `row` are the
    pixel on the canvas of `view`. The triangles are a scene, which is padded so that lenses with
    few triangles share compiled programs. The indices are those of the triangles, without the
    padding, in `scene`.
    """
    x, y = view.x + column - LENS // 2, view.y + row - LENS // 2
    window = replace(view, x=x, y=y, height=LENS, width=LENS)
    nearby_scene, index = cull(scene, window, margin=2.0 + 2.0 * settings.soft_width)
    # Windows with few triangles have arrays of one size, so that they share programs.
    return window, pad(nearby_scene), index


def _sample_layers(
    artist: Artist, scene: Scene, window: View, settings: Settings, bits: int | None
) -> tuple[WindowLayers, int, bool]:
    """Find the nearest layers of each sample of a window, at least down to the first opaque one.

    A layer is a triangle that covers the sample. `bits` is the `grid_bits` of the plan. Returns the
    layers, which include the opaque one; the number of samples along a side of a pixel; and whether
    the layers are complete. They are complete unless the 128 (`_MOST_LAYERS`) nearest layers of
    some sample are all translucent.
    """
    deep_scene = with_flat_depth(scene) if scene.depth is None else scene
    count = LAYERS
    while True:
        compute = partial(find_layers, layers=count)
        layers, plan = artist.with_plan(compute, deep_scene, window, settings, bits)
        layers = on_host(layers)
        is_used = layers.triangle >= 0
        is_translucent = (is_used & (layers.color[..., 3] < 1.0)).all(axis=3)
        is_complete = not is_translucent.any()
        if is_complete or count >= _MOST_LAYERS:
            break
        count *= 2
    listed_layers = layers if scene.depth is not None else layers._replace(depth=None)
    return listed_layers, plan.grid.rate, is_complete


def composite_samples(
    layers: WindowLayers, background: Float[np.ndarray, " channels"]
) -> Float[np.ndarray, "height width samples channels"]:
    """Composite the layers of each sample over a background of straight RGB or RGBA.

    The colour of a layer is multiplied by its coverage. Returns straight colours with as many
    channels as the background.
    """
    channels = background.shape[0]
    total = np.zeros((*layers.triangle.shape[:3], channels))
    transmittance = np.ones(layers.triangle.shape[:3])
    for layer in range(layers.triangle.shape[3]):
        is_used = layers.triangle[..., layer] >= 0
        color = np.where(is_used[..., None], layers.color[..., layer, :], 0.0)
        color = color * layers.coverage[..., layer, None]
        total += transmittance[..., None] * color[..., :channels]
        transmittance = transmittance * (1.0 - color[..., 3])
    total += transmittance[..., None] * premultiply(background)
    return unpremultiply(total)


def list_layers(
    layers: WindowLayers, index: Int[np.ndarray, " triangles"], center: int
) -> list[dict[str, Any]]:
    """List the triangles of the inspected pixel, for JSON, in the order of `layers`.

    That is nearest first, or in reverse draw order under analytic coverage.

    - `index`: for each triangle of `layers`, its index in the complete scene.
    - `center`: row and column of the inspected pixel in `layers`.

    Each triangle is a dictionary:

    - `triangle`: its index in the complete scene.
    - `samples`: the samples of the pixel at which it is listed, numbered row by row.
    - `coverage`: the fraction of the pixel that it covers.
    - `weights`, `color`, `depth`, `uv`, `level`: the arrays of `WindowLayers`, as means over these
      samples. The colour has straight alpha. Arrays that are None are left out, and so is the level
      of a triangle without texture.
    """
    pixel_arrays: dict[str, np.ndarray] = {
        name: np.asarray(value)[center, center]
        for name, value in layers._asdict().items()
        if value is not None
    }
    triangles = pixel_arrays["triangle"]
    order = np.stack([triangles.ravel(), np.indices(triangles.shape)[1].ravel()], axis=1)
    listed = []
    # A triangle is listed behind all triangles that are in front of it at some sample: its position
    # is the deepest layer that it has at any sample.
    position = {
        int(triangle): int(order[order[:, 0] == triangle, 1].max())
        for triangle in np.unique(order[:, 0])
        if triangle >= 0
    }
    for triangle in sorted(position, key=lambda t: (position[t], -t)):
        sample, layer = np.nonzero(triangles == triangle)
        mean = {
            name: array[sample, layer].mean(axis=0)
            for name, array in pixel_arrays.items()
            if name != "triangle"
        }
        row = {
            "triangle": _scene_index(triangle, index),
            "samples": sample.tolist(),
            "coverage": float(pixel_arrays["coverage"][sample, layer].sum() / len(triangles)),
            "weights": mean["weights"].tolist(),
            "color": unpremultiply(mean["color"]).tolist(),
        }
        for name in ("depth", "uv", "level"):
            if name in mean and not np.isnan(mean[name]).any():
                row[name] = mean[name].tolist()
        listed.append(row)
    return listed


def _grid_bits(view: View, settings: Settings) -> int | None:
    """Return the `grid_bits` (see `softras2d.plan`) of the complete canvas of a view.

    A plan for a window of the canvas then snaps vertices to the same grid. None for analytic
    coverage.
    """
    if settings.coverage != "sampled":
        return None
    return Grid.for_canvas(view.height, view.width, settings.hard().rate).bits


def _scene_index(triangle: int, index: Int[np.ndarray, " triangles"]) -> int:
    """Index in the complete scene of a triangle of the window; -1 for the background.

    `triangle` is the index in the window, or -1. `index` has the index in the complete scene of
    each triangle of the window.
    """
    return int(index[triangle]) if triangle >= 0 else -1


def _edges(
    scene: Scene,
    index: Int[np.ndarray, " triangles"],
    layers: WindowLayers,
    window: View,
    center: int,
) -> list[dict[str, Any]]:
    """List the corners of the triangles that cover the inspected pixel, for JSON.

    - `scene`, `index`: the triangles of the window, and their indices in the complete scene.
    - `center`: row and column of the inspected pixel in `layers`.

    Each triangle is a dictionary of `triangle`, its index in the complete scene, and `corners`,
    three (x, y) in pixels of the window.
    """
    named = np.unique(np.asarray(layers.triangle)[center, center])
    positions = np.asarray(scene.positions, np.float64) - [window.x, window.y]
    corners = positions[np.asarray(scene.triangles)]
    return [
        {"triangle": _scene_index(triangle, index), "corners": corners[triangle].tolist()}
        for triangle in named.tolist()
        if triangle >= 0
    ]


def _as_rgba(colors: Float[np.ndarray, "*shape channels"]) -> UInt8[np.ndarray, "*shape 4"]:
    """Convert float colours, clipped to 0..1, to bytes of RGBA; alpha is 255 if there is none."""
    levels = to_bytes(np.asarray(colors, np.float32))
    if levels.shape[-1] == 4:
        return levels
    return np.concatenate([levels, np.full_like(levels[..., :1], 255)], axis=-1)


def _in_rows(
    colors: UInt8[np.ndarray, "height width samples 4"], rate: int
) -> UInt8[np.ndarray, "rows columns 4"]:
    """Arrange the samples of all pixels as one image of samples.

    A pixel has `rate` x `rate` samples. Sample i lies in column i % rate and row i // rate of them.
    """
    height, width = colors.shape[:2]
    grid = colors.reshape(height, width, rate, rate, 4)
    return np.ascontiguousarray(grid.transpose(0, 2, 1, 3, 4).reshape(height * rate, -1, 4))
