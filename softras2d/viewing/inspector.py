"""The pixel inspector: triangles, samples and value of one pixel."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..color import premultiply, unpremultiply
from ..geometry.canvas_grid import Grid
from ..io.images import to_bytes
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
"""Pixels along a side of the lens; the inspected one is in the middle."""

_MOST_LAYERS = 128
"""Layers that are composited at a sample, if so many are translucent."""

_REFERENCE_SAMPLES = 256
"""Samples per pixel of the reference value, where `exact_pixel` knows no exact one."""


class PixelReport(NamedTuple):
    """The values that the inspector shows for a pixel and those around it.

    - `facts`: the inspected pixel, for JSON.
    - `samples`: straight RGBA of each sample of the lens, in rows; one per pixel for analytic
      coverage.
    """

    facts: dict[str, Any]
    samples: UInt8[np.ndarray, "rows columns 4"]


def inspect_pixel(
    artist: Artist, scene: Scene, view: View, settings: Settings, column: int, row: int
) -> PixelReport:
    """Look at one pixel of a view, and at those around it.

    Only a window is drawn, on the grid of the whole canvas. Its samples are those of the canvas,
    but for edges cut at the guard band, within two grid units.
    """
    half = LENS // 2
    window, nearby_scene, index = _window(scene, view, settings, column, row)
    bits = _grid_bits(view, settings)
    is_sampled = settings.coverage == "sampled"
    if is_sampled:
        layers, rate, is_complete = _sample_layers(artist, nearby_scene, window, settings, bits)
        colors = composite_samples(layers, np.asarray(scene.background, np.float64))
        value = unpremultiply(premultiply(colors[half, half]).mean(axis=0))
        if settings.shading == "pixel" or not is_complete:
            # The mean of these samples is not the pixel. Otherwise a program less is compiled.
            value = np.asarray(artist.render(nearby_scene, window, settings, bits)[0])[half, half]
    else:
        # Drawn first, so that the plan is large enough for the layers too.
        colors = np.asarray(artist.render(nearby_scene, window, settings)[0])[:, :, None]
        layers = on_host(artist.with_plan(find_layers, nearby_scene, window, settings)[0])
        value, rate = colors[half, half, 0], 1
    facts = {
        "column": column,
        "row": row,
        "lens": LENS,
        "rate": rate,
        "value": value.tolist(),
        "samples": [
            {"triangle": _name(triangle, index), "color": color.tolist()}
            for triangle, color in zip(
                layers.triangle[half, half, :, 0].tolist(), colors[half, half], strict=True
            )
        ]
        if is_sampled
        else [],
        "layers": list_layers(layers, index, half),
        "most_layers": layers.triangle.shape[3],
        "edges": _edges(nearby_scene, index, layers, window, half),
    }
    return PixelReport(facts, _in_rows(_as_rgba(colors), rate))


def reference_value(
    artist: Artist, scene: Scene, view: View, settings: Settings, column: int, row: int
) -> tuple[str, list[float]]:
    """The value to compare a pixel of a view with, and how it was computed.

    It is the mean of the drawing over the exact area of the pixel, or the value with 256 samples
    where `exact_pixel` has none.
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
    """The window of the lens, the triangles near it, and the index of each in the whole scene."""
    x, y = view.x + column - LENS // 2, view.y + row - LENS // 2
    window = replace(view, x=x, y=y, height=LENS, width=LENS)
    nearby_scene, index = cull(scene, window, margin=2.0 + 2.0 * settings.soft_width)
    # Windows with few triangles have arrays of one size, so that they share programs.
    return window, pad(nearby_scene), index


def _sample_layers(
    artist: Artist, scene: Scene, window: View, settings: Settings, bits: int | None
) -> tuple[WindowLayers, int, bool]:
    """The layers of each sample of a window, down to one that is opaque, and the sampling rate.

    Also whether the layers are complete, as they are unless more than 128 are translucent.
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
    """The colour of each sample, straight, with as many channels as the background."""
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
    layers: WindowLayers, index: Int[np.ndarray, " triangles"], half: int
) -> list[dict[str, Any]]:
    """The triangles of the inspected pixel, nearest first.

    Weights, depth, uv and level are means over the samples that the triangle covers.
    """
    pixel_arrays: dict[str, np.ndarray] = {
        name: np.asarray(value)[half, half]
        for name, value in layers._asdict().items()
        if value is not None
    }
    triangles = pixel_arrays["triangle"]
    order = np.stack([triangles.ravel(), np.indices(triangles.shape)[1].ravel()], axis=1)
    listed = []
    # A triangle lies behind all that lie in front of it in some sample.
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
            "triangle": _name(triangle, index),
            "samples": sample.tolist(),
            "coverage": float(pixel_arrays["coverage"][sample, layer].sum() / len(triangles)),
            "weights": mean["weights"].tolist(),
            "color": unpremultiply(mean["color"]).tolist(),
        }
        for name in ("depth", "uv", "level"):
            if name in mean:
                row[name] = mean[name].tolist()
        listed.append(row)
    return listed


def _grid_bits(view: View, settings: Settings) -> int | None:
    """The grid of the whole canvas, for a window of it; None for analytic coverage."""
    if settings.coverage != "sampled":
        return None
    return Grid.for_canvas(view.height, view.width, settings.hard().rate).bits


def _name(triangle: int, index: Int[np.ndarray, " triangles"]) -> int:
    """The index of a triangle in the whole scene; -1 for the background."""
    return int(index[triangle]) if triangle >= 0 else -1


def _edges(
    scene: Scene,
    index: Int[np.ndarray, " triangles"],
    layers: WindowLayers,
    window: View,
    half: int,
) -> list[dict[str, Any]]:
    """The corners of the triangles that cover the inspected pixel, in pixels of the window."""
    named = np.unique(np.asarray(layers.triangle)[half, half])
    positions = np.asarray(scene.positions, np.float64) - [window.x, window.y]
    corners = positions[np.asarray(scene.triangles)]
    return [
        {"triangle": _name(triangle, index), "corners": corners[triangle].tolist()}
        for triangle in named.tolist()
        if triangle >= 0
    ]


def _as_rgba(colors: Float[np.ndarray, "*shape channels"]) -> UInt8[np.ndarray, "*shape 4"]:
    levels = to_bytes(np.asarray(colors, np.float32))
    if levels.shape[-1] == 4:
        return levels
    return np.concatenate([levels, np.full_like(levels[..., :1], 255)], axis=-1)


def _in_rows(
    colors: UInt8[np.ndarray, "height width samples 4"], rate: int
) -> UInt8[np.ndarray, "rows columns 4"]:
    """Arrange the samples of each pixel as its S x S grid.

    Sample i lies in column i % S and row i // S of the grid; `rate` is S.
    """
    height, width = colors.shape[:2]
    grid = colors.reshape(height, width, rate, rate, 4)
    return np.ascontiguousarray(grid.transpose(0, 2, 1, 3, 4).reshape(height * rate, -1, 4))
