"""Makes the elements that `write_svg` adds for browsers alone: gradients, seams, a style sheet.

Each element, or one around it, has the attribute `data-fallback`, by which `read_svg` skips it. The
only exception is the group around triangles that tile the canvas, since `read_svg` must read these.
Renderers need only plain SVG 1.1. Second gradients, which need a blend mode, are hidden unless
the style sheet finds that the renderer supports the mode.
"""

import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..elements.context import FALLBACK
from .browser_gradients import GradientLines, Gradients, fit_gradients
from .seams import seams, shares_edge, tiles_canvas

_FALLBACK = f'{FALLBACK}="1"'

_PATH = '<path {}d="M{} {} {} {} {} {}z" fill="{}"/>'

# The attribute `display` hides second gradients. Only the style sheet can show them, where the
# renderer supports their blend mode.
_SECOND = f'{_FALLBACK} class="softras2d-second" display="none"'

_GRADIENT = (
    '<linearGradient id="{}" gradientUnits="userSpaceOnUse" x1="{}" y1="{}" x2="{}" y2="{}">'
    "{}</linearGradient>"
)
_FIRST_STOPS = '<stop {}/><stop offset="1" {}/>'
_SECOND_STOPS = '<stop {}/><stop offset="{:.3g}" stop-color="#808080"/><stop offset="1" {}/>'

_SUM_STYLE = (
    "@supports (mix-blend-mode:plus-lighter){.softras2d-tiling{isolation:isolate}"
    ".softras2d-tiling>*{mix-blend-mode:plus-lighter}}"
)
_SECOND_STYLE = (
    "@supports (mix-blend-mode:hard-light){.softras2d-second,.softras2d-tiling>.softras2d-second"
    "{display:inline;mix-blend-mode:hard-light}}"
)


class Elements(NamedTuple):
    """Lines of an SVG file to write around the elements of the triangles.

    - `head`: lines before the first triangle.
    - `before`: text directly before a triangle, by the index of the triangle.
    - `tail`: lines after the last triangle.
    """

    head: list[str]
    before: dict[int, str]
    tail: list[str]


def elements_for_browsers(
    corners: Float[np.ndarray, "triangles 3 2"],
    colors: Float[np.ndarray, "triangles colors channels"],
    is_polygon: Bool[np.ndarray, " triangles"],
    has_gradients: Bool[np.ndarray, " triangles"],
    height: int,
    width: int,
) -> Elements:
    """Make the elements that let browsers show triangles on a `height` x `width` canvas, in pixels.

    They are paths with gradients; lines along shared edges, which hide gaps between opaque
    triangles (`seams.py`); and a style sheet for blend modes.

    - `corners`: corners of the triangles in pixels, in draw order.
    - `colors`: sRGB, one per triangle or per corner, with 3 or 4 channels.
    - `is_polygon`: whether each triangle is written as an element that browsers draw as it is.
    - `has_gradients`: whether paths with gradients are to be made for each triangle.

    Browsers do not show a triangle for which neither flag is true, so nothing is made for it.
    """
    # The coordinates are rounded to about 1e-5 of the canvas: much less than a pixel, and short.
    decimals = max(1, 5 - len(str(math.ceil(max(height, width)) - 1)))
    coordinates = _decimal_texts(corners, decimals)
    is_opaque = (colors[..., 3:] == 1).all(axis=(1, 2))
    opaque = np.flatnonzero(is_opaque & (is_polygon | has_gradients))
    is_tiling = len(opaque) == len(corners) and tiles_canvas(corners, height, width)
    mean_colors = _hex_colors(colors[opaque].astype(np.float64).mean(axis=1))
    seam_groups = seams(corners[opaque], coordinates[opaque], mean_colors)
    definitions, first, second = [], {}, {}
    shaded = np.flatnonzero(has_gradients)
    if len(shaded):
        gradients = fit_gradients(corners[shaded], colors[shaded])
        definitions = _definitions(gradients, decimals)
        paths = _first_paths(corners[shaded], coordinates[shaded], colors[shaded], gradients)
        first = dict(zip(shaded.tolist(), paths, strict=True))
        # Each path is hidden unless the style sheet shows it. In a tiling, all of them are in a
        # group that is hidden instead.
        attributes = "" if is_tiling else f"{_SECOND} "
        paths = _second_paths(coordinates[shaded], gradients, attributes)
        second = {int(shaded[row]): path for row, path in paths.items()}
    head = [f"<defs {_FALLBACK}>", *definitions, "</defs>"] if definitions else []
    style = _SUM_STYLE * is_tiling + _SECOND_STYLE * bool(second)
    if style:
        head.insert(0, f"<style {_FALLBACK}>{style}</style>")

    if is_tiling:
        # Seam lines below the sum fill pixels that a browser does not cover completely: Chromium
        # rounds corners to quarters of a pixel. Second gradients must lie over the complete sum.
        head += [*seam_groups.values(), '<g class="softras2d-tiling">']
        tail = [f"<g {_SECOND}>", *second.values(), "</g>"] if second else []
        return Elements(head, first, [*tail, "</g>"])
    before = defaultdict(list)
    for start, group in seam_groups.items():
        before[int(opaque[start])].append(group)
    for index, path in [*first.items(), *second.items()]:
        before[index].append(path)
    return Elements(head, {index: "\n".join(lines) for index, lines in before.items()}, [])


def _first_paths(
    corners: Float[np.ndarray, "triangles 3 2"],
    coordinates: np.ndarray,
    colors: Float[np.ndarray, "triangles 3 channels"],
    gradients: Gradients,
) -> list[str]:
    """Make a path for each triangle, filled with its first gradient or with its mean colour.

    `coordinates` are `corners` as text, `[triangles, 3, 2]`. `gradients` has a row per triangle.
    """
    fills = np.array(_hex_colors(gradients.mean), object)
    is_gradient = gradients.first.is_valid
    opacities = _decimal_texts(gradients.mean[:, 3:], 3)
    for row in np.flatnonzero(~is_gradient & (gradients.mean[:, 3:] < 1).any(axis=1)).tolist():
        fills[row] += f'" fill-opacity="{opacities[row, 0]}'
    rows = np.flatnonzero(is_gradient)
    fills[rows] = [f"url(#a{row})" for row in rows.tolist()]
    attributes = np.full(len(colors), f"{_FALLBACK} ", object)
    # Where antialiased translucent triangles abut, what lies below shows as thin lines, and a seam
    # line would be visible through them. Without antialiasing, exactly one of them covers the
    # centre of each pixel; outlines become jagged instead.
    translucent = np.flatnonzero((colors[..., 3:] < 1).any(axis=(1, 2)))
    abutting = translucent[shares_edge(corners[translucent])]
    attributes[abutting] = f'{_FALLBACK} shape-rendering="crispEdges" '
    return list(map(_PATH.format, attributes, *coordinates.reshape(-1, 6).T, fills))


def _second_paths(coordinates: np.ndarray, gradients: Gradients, attributes: str) -> dict[int, str]:
    """Make a path for each triangle that has a second gradient, by its row in `gradients`.

    - `coordinates`: corners of the triangles as text, `[triangles, 3, 2]`.
    - `attributes`: text of further attributes of every path, with a blank at its end, or empty.
    """
    rows = np.flatnonzero(gradients.has_second).tolist()
    fills = [f"url(#b{row})" for row in rows]
    columns = coordinates[rows].reshape(-1, 6).T
    paths = map(_PATH.format, [attributes] * len(rows), *columns, fills)
    return dict(zip(rows, paths, strict=True))


def _definitions(gradients: Gradients, decimals: int) -> list[str]:
    """The `<linearGradient>` elements of all gradients.

    The `id` of a first gradient is `a` and the row of its triangle in `gradients`; the `id` of a
    second gradient is `b` and the row. Coordinates are rounded to `decimals` decimals.
    """
    rows = np.flatnonzero(gradients.first.is_valid)
    low, high = (_stop_attributes(colors[rows]) for colors in gradients.first_colors)
    stops = list(map(_FIRST_STOPS.format, low, high))
    first = _gradient_elements("a", rows, gradients.first, decimals, stops)
    rows = np.flatnonzero(gradients.has_second)
    low, high = (_stop_attributes(colors[rows]) for colors in gradients.second_colors)
    stops = list(map(_SECOND_STOPS.format, low, gradients.second_grey[rows].tolist(), high))
    return first + _gradient_elements("b", rows, gradients.second, decimals, stops)


def _gradient_elements(
    prefix: str, rows: np.ndarray, lines: GradientLines, decimals: int, stops: list[str]
) -> list[str]:
    """The `<linearGradient>` elements along some of the lines.

    - `prefix`: the `id` of an element is `prefix` and the index of its row.
    - `rows`: indices in `lines` of the rows for which an element is made.
    - `decimals`: decimals to which coordinates are rounded.
    - `stops`: the text of the stops of each of `rows`.
    """
    names = [f"{prefix}{row}" for row in rows.tolist()]
    ends = np.concatenate([lines.start[rows], lines.end[rows]], axis=1)
    return list(map(_GRADIENT.format, names, *_decimal_texts(ends, decimals).T, stops))


def _stop_attributes(colors: Float[np.ndarray, "stops channels"]) -> list[str]:
    """For each colour of 3 or 4 channels, the attributes of a `<stop>` as text."""
    paints = [f'stop-color="{color}"' for color in _hex_colors(colors)]
    if colors.shape[1] == 3:
        return paints
    opacities = _decimal_texts(colors[:, 3], 3).tolist()
    return [
        paint if opacity == "1" else f'{paint} stop-opacity="{opacity}"'
        for paint, opacity in zip(paints, opacities, strict=True)
    ]


def _hex_colors(colors: Float[np.ndarray, "colors channels"]) -> list[str]:
    """The text `#rrggbb` of each colour, clipped to 0..1 and rounded to 8 bits, without alpha."""
    levels = np.rint(np.clip(colors[:, :3], 0.0, 1.0) * 255.0).astype(np.int64)
    return [f"#{code:06x}" for code in (levels @ np.array([65536, 256, 1])).tolist()]


def _decimal_texts(values: Float[np.ndarray, "*shape"], decimals: int) -> np.ndarray:
    """Round numbers to `decimals` decimals; returns an array of strings of the same shape.

    Whole numbers have no decimal point.
    """
    # Adding zero turns -0 into 0.
    rounded = np.round(values.astype(np.float64), decimals) + 0.0
    texts = [text.removesuffix(".0") for text in map(repr, rounded.ravel().tolist())]
    return np.array(texts, object).reshape(values.shape)
