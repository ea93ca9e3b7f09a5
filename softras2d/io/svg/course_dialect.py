"""Reads elements with the meaning of the course's dialect, quirks included."""

import re

import numpy as np

from ...geometry import affine_maps
from ..budget import MAX_TRIANGLES
from .context import FALLBACK, SILENT, Context
from .document import Children
from .numbers import blank_separated, leading_float, number_pairs
from .style import Rgba
from .transform_attribute import course_transform
from .view_box import course_view, own_size

_HEX = re.compile(r"\s*+#?+([0-9a-fA-F]*+)")

_PIXELS_AT_ONCE = 2**18
"""Pixels of an `image` that become rectangles together."""


class CourseReader:
    """Draws a document into its context.

    Style is the element's own: only `transform` passes down. Elements without meaning are left out
    with all that they hold.
    """

    def __init__(self, context: Context):
        self._context = context
        self._maps: list[np.ndarray] = []
        self._size = (0.0, 0.0)
        self._shapes = {
            "colortri": self._colortri,
            "image": self._image,
            "line": self._line,
            "polygon": self._polygon,
            "polyline": self._polyline,
            "rect": self._rect,
            "textri": self._textri,
        }

    def open(self, tag: str, attributes: dict[str, str], line: int) -> Children:
        """Draw the element, or go into it."""
        self._context.display.line = line
        if not self._maps:
            self._root(tag, attributes)
            return Children.READ
        if FALLBACK in attributes:
            return Children.SKIPPED
        if tag == "texture":
            self._context.assets.declare(
                attributes.get("texid", ""), attributes.get("filename", "")
            )
            return Children.NAMED
        if tag != "g" and tag not in self._shapes:
            # Prefixed names are other vocabularies.
            if tag not in SILENT and ":" not in tag:
                self._context.elements[tag] += 1
            return Children.SKIPPED
        map3 = self._maps[-1]
        if "transform" in attributes:
            map3 = map3 @ course_transform(attributes["transform"], self._unknown_function)
        if tag == "g":
            self._maps.append(map3)
            return Children.READ
        self._shapes[tag](map3, attributes)
        return Children.NAMED

    def inside(self, tag: str, attributes: dict[str, str], line: int) -> None:
        """A child of a shape, which is not looked at."""
        if tag not in SILENT and ":" not in tag and FALLBACK not in attributes:
            self._context.elements[tag] += 1

    def close(self) -> None:
        """Back out of a group; out of the root, draw the frame."""
        map3 = self._maps.pop()
        if not self._maps and self._context.frame:
            self._frame(map3)

    def _root(self, tag: str, attributes: dict[str, str]) -> None:
        if tag != "svg":
            raise ValueError("is the root, which must be <svg>.")
        size = own_size(attributes, "course")
        map3 = self._context.transform
        if map3 is None:
            if size is None:
                raise ValueError("has no width and height, by which the course places a drawing.")
            map3 = course_view(size, self._context.height, self._context.width)
        self._size = size or (0.0, 0.0)
        self._maps.append(map3)

    def _unknown_function(self, name: str) -> None:
        self._context.ignored[f"transform {name!r}"] += 1

    def _color(self, attributes: dict[str, str], name: str) -> Rgba:
        """A paint: hex digits, without any the black 0; with its opacity if that is honoured."""
        found = _HEX.match(attributes.get(name, ""))
        code = min(int((found and found[1]) or "0", 16), 0xFFFFFFFF)
        red, green, blue = (float(np.float32((code >> shift & 255) / 255)) for shift in (16, 8, 0))
        return red, green, blue, self._opacity(attributes, name)

    def _opacity(self, attributes: dict[str, str], name: str) -> float:
        text = attributes.get(f"{name}-opacity")
        if text is None or not self._context.opacity:
            return 1.0
        return min(max(leading_float(text), 0.0), 1.0)

    def _rect(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        x, y, width, height = (
            leading_float(attributes.get(n)) for n in ("x", "y", "width", "height")
        )
        fill = self._color(attributes, "fill")
        if width == 0 and height == 0:
            self._point(affine_maps.apply(map3, [[x, y]])[0], fill)
            return
        left_right = np.array([[x, y], [x + width, y], [x, y + height], [x + width, y + height]])
        a, b, c, d = corners = affine_maps.apply(map3, left_right)
        if fill[3] < 1:
            self._context.display.add_polygon(corners[[0, 1, 3, 2]], fill)
        else:
            self._context.display.add_triangles(np.array([[a, b, c], [c, b, d]]), fill)
        self._outline(corners[[0, 1, 3, 2]], attributes)

    def _point(self, place: np.ndarray, color: Rgba) -> None:
        x, y = np.floor(place.astype(np.float32)).astype(np.float64)
        if 0 <= x < self._context.width and 0 <= y < self._context.height:
            rectangle = np.array([[x, y, x + 1, y + 1]])
            self._context.display.add_pixels(rectangle, np.array([color]))

    def _polygon(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        points = number_pairs(attributes.get("points", ""))
        plane = np.array(points, np.float32).reshape(-1, 2)
        corners = affine_maps.apply(map3, plane)
        if len(plane) > 2:
            self._context.display.add_ears(plane, corners, self._color(attributes, "fill"))
        self._outline(corners, attributes)

    def _outline(self, corners: np.ndarray, attributes: dict[str, str]) -> None:
        """The closed chain of pixel lines, if there is a stroke; `none` is one, and black."""
        if "stroke" in attributes and len(corners):
            self._lines(corners, np.roll(corners, -1, axis=0), self._color(attributes, "stroke"))

    def _polyline(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        points = np.array(number_pairs(attributes.get("points", ""))).reshape(-1, 2)
        if len(points) > 1:
            corners = affine_maps.apply(map3, points)
            self._lines(corners[:-1], corners[1:], self._color(attributes, "stroke"))

    def _line(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        ends = [leading_float(attributes.get(name)) for name in ("x1", "y1", "x2", "y2")]
        if "stroke" in attributes:
            start, end = affine_maps.apply(map3, np.reshape(ends, (2, 2)))
            self._lines(start[None], end[None], self._color(attributes, "stroke"))

    def _lines(self, starts: np.ndarray, ends: np.ndarray, color: Rgba) -> None:
        self._context.display.add_hairlines(np.concatenate([starts, ends], axis=1), color)

    def _colortri(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        colors = _numbers(attributes, "colors", 12).reshape(3, 4)
        colors[:, 3] = self._opacity(attributes, "fill")
        self._context.display.add_triangles(affine_maps.apply(map3, points)[None], colors)

    def _textri(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        uv = _numbers(attributes, "uvs", 6).reshape(3, 2)
        texture = self._context.assets.texture(attributes.get("texid", ""))
        white = (1.0, 1.0, 1.0, self._opacity(attributes, "fill"))
        self._context.display.add_textured(
            affine_maps.apply(map3, points), white, uv, texture, False
        )

    def _image(self, map3: np.ndarray, attributes: dict[str, str]) -> None:
        """A point for every pixel between the two corners; a mirrored image draws nothing."""
        x, y, width, height = (
            leading_float(attributes.get(n)) for n in ("x", "y", "width", "height")
        )
        href = attributes.get("xlink:href", attributes.get("href"))
        if href is None:
            self._context.ignored["image without href"] += 1
            return
        picture = self._context.assets.picture(href)[..., :3]
        ends = affine_maps.apply(map3, [[x, y], [x + width, y + height]]).astype(np.float32)
        columns, u = _pixels(ends[:, 0], self._context.width)
        rows, v = _pixels(ends[:, 1], self._context.height)
        if len(columns) == 0 or len(rows) == 0:
            return
        display = self._context.display
        display.budget.charge("steps", len(columns) * len(rows))
        # A few rows at a time, and no more than can be drawn: `add_pixels` refuses these.
        step = max(_PIXELS_AT_ONCE // len(columns), 1)
        rectangles, colors, count = [], [], 0
        for block in range(0, len(rows), step):
            some, some_v = rows[block : block + step], v[block : block + step]
            places, shades = _merged(some, columns, _bilinear(picture, u, some_v))
            rectangles.append(places)
            colors.append(np.pad(shades, ((0, 0), (0, 1)), constant_values=1.0))
            count += len(places)
            if 2 * count > MAX_TRIANGLES:
                break
        display.add_pixels(np.concatenate(rectangles), np.concatenate(colors))

    def _frame(self, map3: np.ndarray) -> None:
        """The black outline of the drawing, moved out by a pixel across and in by one along."""
        height, width = self._size
        corners = affine_maps.apply(map3, [[0, 0], [width, 0], [0, height], [width, height]])
        a, b, c, d = corners + np.array([[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        self._lines(np.array([a, a, d, d]), np.array([b, c, b, c]), (0.0, 0.0, 0.0, 1.0))


def _numbers(attributes: dict[str, str], name: str, count: int) -> np.ndarray:
    try:
        numbers = blank_separated(attributes.get(name, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) < count:
        raise ValueError(
            f"{name}: expected {count} numbers with blanks between, got {len(numbers)}."
        )
    return np.array(numbers[:count])


def _pixels(ends: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixels on the canvas from one end to the other, and where in the picture each lies."""
    low, high = float(ends[0]), float(ends[1])
    first, last = max(np.floor(low), 0.0), min(np.floor(high), side - 1.0)
    if high < low or last < first:
        return np.zeros(0), np.zeros(0)
    pixels = np.arange(int(first), int(last) + 1, dtype=np.float64)
    return pixels, (pixels + 0.5 - low) / (high - low + 1.0)


def _bilinear(picture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Colours `[rows, columns, 3]` between the four texels around each position."""
    tall, wide = picture.shape[:2]
    x, y = u * (wide - 1), v * (tall - 1)
    left, top = np.floor(x), np.floor(y)
    columns = [np.clip(left + k, 0, wide - 1).astype(np.int64) for k in (0, 1)]
    rows = [np.clip(top + k, 0, tall - 1).astype(np.int64) for k in (0, 1)]
    across, down = (x - left)[None, :, None], (y - top)[:, None, None]
    upper, lower = (
        picture[row][:, columns[0]] * (1 - across) + picture[row][:, columns[1]] * across
        for row in rows
    )
    return upper * (1 - down) + lower * down


def _merged(
    rows: np.ndarray, columns: np.ndarray, colors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rectangles `[k, 4]` and RGB `[k, 3]`: neighbours of equal colour in a row are one."""
    changes = np.ones(colors.shape[:2], bool)
    changes[:, 1:] = (colors[:, 1:] != colors[:, :-1]).any(axis=-1)
    row, place = np.nonzero(changes)
    # A run ends where the next begins, or with the row.
    following = np.append(place[1:], len(columns))
    ends = np.where(following > place, following, len(columns))
    rectangles = np.stack([columns[place], rows[row], columns[ends - 1] + 1, rows[row] + 1], axis=1)
    return rectangles, colors[row, place]
