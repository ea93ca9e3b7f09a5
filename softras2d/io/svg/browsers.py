"""Elements that `write_svg` adds for browsers alone: gradients, seams, and a style sheet.

Each is marked `data-fallback`, by which `read_svg` skips it. Everything here works in renderers
that know plain SVG 1.1; what needs a blend mode is hidden unless the style sheet finds the mode.
"""

from typing import NamedTuple

import numpy as np

from .context import FALLBACK
from .gradients import Gradients, Line, fit_gradients
from .seams import seams, shares_edge, tiles_canvas

_FALLBACK = f'{FALLBACK}="1"'

_PATH = '<path {}d="M{} {} {} {} {} {}z" fill="{}"/>'

# The attribute hides it from renderers without style sheets.
_SECOND = f'{_FALLBACK} class="softras2d-second" display="none"'

_GRADIENT = (
    '<linearGradient id="{}" gradientUnits="userSpaceOnUse" x1="{}" y1="{}" x2="{}" y2="{}">'
    "{}</linearGradient>"
)
_STOPS = '<stop {}/><stop offset="1" {}/>'
_STOPS_OF_SECOND = '<stop {}/><stop offset="{:.3g}" stop-color="#808080"/><stop offset="1" {}/>'

_SUM_STYLE = (
    "@supports (mix-blend-mode:plus-lighter){.softras2d-tiling{isolation:isolate}"
    ".softras2d-tiling>*{mix-blend-mode:plus-lighter}}"
)
_SECOND_STYLE = (
    "@supports (mix-blend-mode:hard-light){.softras2d-second,.softras2d-tiling>.softras2d-second"
    "{display:inline;mix-blend-mode:hard-light}}"
)


class Elements(NamedTuple):
    """Lines of an SVG file: before all triangles, before single ones by index, and after all."""

    head: list[str]
    before: dict[int, str]
    tail: list[str]


def elements_for_browsers(
    corners: np.ndarray,
    colors: np.ndarray,
    is_polygon: np.ndarray,
    in_gradients: np.ndarray,
    height: int,
    width: int,
) -> Elements:
    """What browsers need beside the elements of the triangles `corners` `[n, 3, 2]`.

    `colors` are `[n, 1 or 3, 3 or 4]`. Browsers draw the polygons among the triangles as they are;
    those of `in_gradients` get paths; others are not shown, and get nothing.
    """
    # A hundred-thousandth of the canvas is finer than its pixels, and short.
    decimals = max(1, 5 - len(str(max(height, width) - 1)))
    points = _decimals(corners, decimals)
    is_opaque = (colors[..., 3:] == 1).all(axis=(1, 2))
    opaque = np.flatnonzero(is_opaque & (is_polygon | in_gradients))
    is_tiling = len(opaque) == len(corners) and tiles_canvas(corners, height, width)
    head, tail, styles = [], [], [_SUM_STYLE] * is_tiling

    means = _hex(colors[opaque].astype(np.float64).mean(axis=1))
    groups = seams(corners[opaque], points[opaque], means)
    before = {} if is_tiling else {int(opaque[start]): g for start, g in groups.items()}
    shaded = np.flatnonzero(in_gradients)
    if len(shaded):
        gradients = fit_gradients(corners[shaded], colors[shaded])
        first = _first_paths(corners[shaded], points[shaded], colors[shaded], gradients)
        second = _second_paths(points[shaded], gradients, "" if is_tiling else _SECOND + " ")
        for row, index in enumerate(shaded.tolist()):
            paths = [first[row]]
            if row in second and not is_tiling:
                paths.append(second[row])
            before[index] = "\n".join([before[index], *paths] if index in before else paths)
        if is_tiling and second:
            # Over the finished sum: while it grows, the mode would see too little below it.
            tail = [f"<g {_SECOND}>", *second.values(), "</g>"]
        styles += [_SECOND_STYLE] * bool(second)
        definitions = _definitions(gradients, decimals)
        head += [f"<defs {_FALLBACK}>", *definitions, "</defs>"] if definitions else []
    if styles:
        head.insert(0, f"<style {_FALLBACK}>{''.join(styles)}</style>")
    if is_tiling:
        # The seams lie below the sum, for pixels of which a browser loses a part: Chromium's
        # corners are at quarters of a pixel.
        head, tail = [*head, *groups.values(), '<g class="softras2d-tiling">'], [*tail, "</g>"]
    return Elements(head, before, tail)


def _first_paths(
    corners: np.ndarray, points: np.ndarray, colors: np.ndarray, gradients: Gradients
) -> list[str]:
    """A path for each triangle, filled with its first gradient or its mean colour."""
    fills = np.array(_hex(gradients.mean), object)
    is_line = gradients.first.is_valid
    opacities = _decimals(gradients.mean[:, 3:], 3)
    for row in np.flatnonzero(~is_line & (gradients.mean[:, 3:] < 1).any(axis=1)).tolist():
        fills[row] += f'" fill-opacity="{opacities[row, 0]}'
    lines = np.flatnonzero(is_line)
    fills[lines] = [f"url(#a{row})" for row in lines.tolist()]
    attributes = np.full(len(colors), f"{_FALLBACK} ", object)
    # Where translucent triangles abut, what is below would show as hairlines, and a seam would be
    # seen. Without antialiasing each pixel centre is in one triangle; outlines have stairs.
    translucent = np.flatnonzero((colors[..., 3:] < 1).any(axis=(1, 2)))
    abutting = translucent[shares_edge(corners[translucent])]
    attributes[abutting] = f'{_FALLBACK} shape-rendering="crispEdges" '
    return list(map(_PATH.format, attributes, *points.reshape(-1, 6).T, fills))


def _second_paths(points: np.ndarray, gradients: Gradients, attributes: str) -> dict[int, str]:
    """A path for each triangle that needs a second gradient, by its row."""
    rows = np.flatnonzero(gradients.has_second).tolist()
    fills = [f"url(#b{row})" for row in rows]
    coordinates = points[rows].reshape(-1, 6).T
    paths = map(_PATH.format, [attributes] * len(rows), *coordinates, fills)
    return dict(zip(rows, paths, strict=True))


def _definitions(gradients: Gradients, decimals: int) -> list[str]:
    rows = np.flatnonzero(gradients.first.is_valid)
    stops = list(map(_STOPS.format, *(_stops(ends[rows]) for ends in gradients.first_colors)))
    first = _lines("a", rows, gradients.first, decimals, stops)
    rows = np.flatnonzero(gradients.has_second)
    low, high = (_stops(ends[rows]) for ends in gradients.second_colors)
    stops = list(map(_STOPS_OF_SECOND.format, low, gradients.second_middle[rows].tolist(), high))
    return first + _lines("b", rows, gradients.second, decimals, stops)


def _lines(prefix: str, rows: np.ndarray, line: Line, decimals: int, stops: list[str]) -> list[str]:
    names = [f"{prefix}{row}" for row in rows.tolist()]
    ends = np.concatenate([line.start[rows], line.end[rows]], axis=1)
    return list(map(_GRADIENT.format, names, *_decimals(ends, decimals).T, stops))


def _stops(colors: np.ndarray) -> list[str]:
    """The attributes of a stop, for each colour of `[n, 3 or 4]`."""
    paints = [f'stop-color="{color}"' for color in _hex(colors)]
    if colors.shape[1] == 3:
        return paints
    opacities = _decimals(colors[:, 3], 3).tolist()
    return [
        paint if opacity == "1" else f'{paint} stop-opacity="{opacity}"'
        for paint, opacity in zip(paints, opacities, strict=True)
    ]


def _hex(colors: np.ndarray) -> list[str]:
    """The nearest bytes of each colour `[n, 3 or 4]`, as `#rrggbb`."""
    levels = np.rint(np.clip(colors[:, :3], 0.0, 1.0) * 255.0).astype(np.int64)
    return [f"#{code:06x}" for code in (levels @ np.array([65536, 256, 1])).tolist()]


def _decimals(values: np.ndarray, decimals: int) -> np.ndarray:
    """Numbers rounded to at most so many decimals, as text in an array of objects."""
    rounded = np.round(values.astype(np.float64), decimals) + 0.0
    texts = [text.removesuffix(".0") for text in map(repr, rounded.ravel().tolist())]
    return np.array(texts, object).reshape(values.shape)
