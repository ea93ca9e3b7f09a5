"""Draws the SVG subset of the classic rasterizer course, including its deviations from SVG.

It is the dialect `"course"` of `read_svg`.
"""

import re

import numpy as np
from jaxtyping import Float, Float32

from ....geometry import affine_maps
from ...budget import MAX_TRIANGLES
from ..elements.context import FALLBACK, SILENT, Context
from ..elements.view_box import course_size, course_view
from ..values.css_color import Rgba
from ..values.numbers import blank_separated, leading_float, number_pairs
from ..values.transform_attribute import course_transform
from ..xml.document import Attributes, Children

_HEX = re.compile(r"\s*+#?+([0-9a-fA-F]*+)")

_PIXELS_AT_ONCE = 2**18
"""Maximum number of pixels of an `image` that are sampled at once, which bounds memory.

The pixels of one row are always sampled at once, even if they are more.
"""


class CourseReader:
    """Draws the elements of a document by the course's rules, including its deviations from SVG.

    It is a `Reader` for `document.walk`, and adds shapes to the display list of `context`. Only
    `transform` is inherited: every element has its own style. A method that is named after an
    element, such as `_rect`, draws this element. Its argument `map3` is the homogeneous map `[3,
    3]` from the user units of the element to pixels. Coordinates and sizes that an element lacks
    are 0; only `colortri` and `textri` must have theirs.
    """

    def __init__(self, context: Context):
        self._context = context
        self._size = (0.0, 0.0)
        # Maps `[3, 3]` to pixels from the units of the root and of each open group.
        self._maps: list[np.ndarray] = []
        self._shapes = {
            "colortri": self._colortri,
            "image": self._image,
            "line": self._line,
            "polygon": self._polygon,
            "polyline": self._polyline,
            "rect": self._rect,
            "textri": self._textri,
        }

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """Draw a shape, declare a texture, or enter the root or a group.

        Returns how `walk` treats the children of the element. Elements that the course does not
        know are skipped with their children, and counted for the warning. Elements for which
        `_is_silent` is true are skipped without being counted.
        """
        self._context.display.line = line
        if not self._maps:
            self._maps.append(self._root_map(tag, attributes))
            return Children.READ
        if _is_silent(tag, attributes):
            return Children.SKIPPED
        if tag == "texture":
            self._context.declare_texture(attributes)
            return Children.NAMED
        if tag != "g" and tag not in self._shapes:
            self._context.unsupported_elements[tag] += 1
            return Children.SKIPPED
        map3 = self._maps[-1]
        if "transform" in attributes:
            map3 = map3 @ course_transform(attributes["transform"], self._unknown_function)
        if tag == "g":
            self._maps.append(map3)
            return Children.READ
        self._shapes[tag](map3, attributes)
        return Children.NAMED

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """Count a child of a shape or of a texture for the warning, since the course ignores it.

        Elements for which `_is_silent` is true are not counted.
        """
        if not _is_silent(tag, attributes):
            self._context.unsupported_elements[tag] += 1

    def close(self) -> None:
        """Leave a group or the root. At the end of the root, draw the frame if `context.frame`.

        The frame is the black outline of the drawing. Raises `ValueError` if the map to pixels
        sends a corner of the drawing to infinity or beyond (w <= 0).
        """
        map3 = self._maps.pop()
        if self._maps or not self._context.frame:
            return
        try:
            self._frame(map3)
        except ValueError as error:
            raise ValueError(f"cannot be framed: {error}") from None

    def _root_map(self, tag: str, attributes: Attributes) -> np.ndarray:
        """The map `[3, 3]` from the root's user units to pixels.

        It is the transform that the caller of the reader gave or, without one, the map of
        `course_view`. The size of the drawing is stored for `_frame`. Raises `ValueError` unless
        the root is `svg`, and if it has no size and there is no transform.
        """
        if tag != "svg":
            raise ValueError("is the root, which must be <svg>.")
        size = course_size(attributes)
        map3 = self._context.transform
        if map3 is None:
            if size is None:
                raise ValueError("needs width and height in the course's dialect; it has none.")
            map3 = course_view(size, self._context.height, self._context.width)
        self._size = size or (0.0, 0.0)
        return map3

    def _unknown_function(self, name: str) -> None:
        """Count a transform function that the course does not know, for the warning."""
        self._context.ignored[f"transform {name!r}"] += 1

    def _color(self, attributes: Attributes, name: str) -> Rgba:
        """The colour whose hex digits are the value of the attribute `name`, `fill` or `stroke`.

        All digits form one number, whose low 24 bits are red, green and blue, so `#f` is a dark
        blue. A number of over 32 bits is white. Black is the colour of a missing attribute, and of
        a value without hex digits after its leading blanks and at most one `#`. The alpha is the
        result of `_opacity`.
        """
        match = _HEX.match(attributes.get(name, ""))
        code = min(int((match and match[1]) or "0", 16), 0xFFFFFFFF)
        red, green, blue = (float(np.float32((code >> shift & 255) / 255)) for shift in (16, 8, 0))
        return red, green, blue, self._opacity(attributes, name)

    def _opacity(self, attributes: Attributes, name: str) -> float:
        """Read the attribute `fill-opacity` or `stroke-opacity`, clamped to 0..1.

        `name` is `fill` or `stroke`. The result is 1 if the attribute is missing, and if the reader
        does not apply opacities. Raises `ValueError` for text that does not begin with a number.
        """
        text = attributes.get(f"{name}-opacity")
        if text is None or not self._context.opacity:
            return 1.0
        return min(max(leading_float(text), 0.0), 1.0)

    def _rect(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `rect`, and its outline if it has the attribute `stroke`.

        If width and height are both 0, the pixel that contains its corner is filled instead.
        """
        x, y, width, height = (
            leading_float(attributes.get(n)) for n in ("x", "y", "width", "height")
        )
        fill = self._color(attributes, "fill")
        if width == 0 and height == 0:
            self._point(affine_maps.apply(map3, [[x, y]])[0], fill)
            return
        points = np.array([[x, y], [x + width, y], [x, y + height], [x + width, y + height]])
        a, b, c, d = corners = affine_maps.apply(map3, points)
        if fill[3] < 1:
            self._context.display.add_polygon(corners[[0, 1, 3, 2]], fill)
        else:
            self._context.display.add_triangles(np.array([[a, b, c], [c, b, d]]), fill)
        self._outline(corners[[0, 1, 3, 2]], attributes)

    def _point(self, position: np.ndarray, color: Rgba) -> None:
        """Fill the pixel that contains the position `[x, y]`, in pixels, if it is on the canvas."""
        x, y = np.floor(position.astype(np.float32)).astype(np.float64)
        if 0 <= x < self._context.width and 0 <= y < self._context.height:
            rectangle = np.array([[x, y, x + 1, y + 1]])
            self._context.display.add_pixels(rectangle, np.array([color]))

    def _polygon(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `polygon`, which the course's ear clipping triangulates, and its outline.

        A polygon of fewer than three points is not filled. The outline needs the attribute
        `stroke`.
        """
        points = np.array(number_pairs(attributes.get("points", "")), np.float32).reshape(-1, 2)
        corners = affine_maps.apply(map3, points)
        if len(points) > 2:
            self._context.display.add_ears(points, corners, self._color(attributes, "fill"))
        self._outline(corners, attributes)

    def _outline(self, corners: np.ndarray, attributes: Attributes) -> None:
        """Draw pixel lines around corners `[n, 2]`, in pixels, if the attribute `stroke` exists.

        The last corner is joined to the first. The value `none` is black, since it does not
        begin with hex digits.
        """
        if "stroke" in attributes and len(corners):
            self._lines(corners, np.roll(corners, -1, axis=0), self._color(attributes, "stroke"))

    def _polyline(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `polyline` with lines one pixel wide; without an attribute `stroke`, in black."""
        points = np.array(number_pairs(attributes.get("points", ""))).reshape(-1, 2)
        if len(points) > 1:
            corners = affine_maps.apply(map3, points)
            self._lines(corners[:-1], corners[1:], self._color(attributes, "stroke"))

    def _line(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `line` one pixel wide, if it has the attribute `stroke`."""
        ends = [leading_float(attributes.get(name)) for name in ("x1", "y1", "x2", "y2")]
        if "stroke" in attributes:
            start, end = affine_maps.apply(map3, np.reshape(ends, (2, 2)))
            self._lines(start[None], end[None], self._color(attributes, "stroke"))

    def _lines(self, starts: np.ndarray, ends: np.ndarray, color: Rgba) -> None:
        """Draw lines one pixel wide, as one shape: line k goes from `starts[k]` to `ends[k]`.

        `starts` and `ends` are points `[n, 2]` in pixels.
        """
        self._context.display.add_hairlines(np.concatenate([starts, ends], axis=1), color)

    def _colortri(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `colortri`, a triangle with a colour for each corner.

        Each colour is RGBA in 0..1, but its alpha is replaced by the element's `fill-opacity`.
        """
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        colors = _numbers(attributes, "colors", 12).reshape(3, 4)
        colors[:, 3] = self._opacity(attributes, "fill")
        self._context.display.add_triangles(affine_maps.apply(map3, points)[None], colors)

    def _textri(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw a `textri`, a triangle with a texture that an earlier `texture` element declares.

        Its opacity is its `fill-opacity`.
        """
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        uv = _numbers(attributes, "uvs", 6).reshape(3, 2)
        texture = self._context.assets.texture(attributes.get("texid", ""))
        white = (1.0, 1.0, 1.0, self._opacity(attributes, "fill"))
        self._context.display.add_textured(
            affine_maps.apply(map3, points), white, uv, texture, False
        )

    def _image(self, map3: np.ndarray, attributes: Attributes) -> None:
        """Draw an `image` by filling all pixels from its top left to its bottom right corner.

        The corners are mapped to pixels, but a rotation or skew of the image is ignored, and a
        mirrored image draws nothing. Each pixel has the colour of the image at its centre, sampled
        bilinearly and opaque. An image without `href` is counted for the warning. Raises
        `ValueError` for corners that are not finite in float32.
        """
        x, y, width, height = (
            leading_float(attributes.get(n)) for n in ("x", "y", "width", "height")
        )
        href = attributes.get("xlink:href", attributes.get("href"))
        if href is None:
            self._context.ignored["image without href"] += 1
            return
        picture = self._context.assets.picture(href)[..., :3]
        ends = affine_maps.apply(map3, [[x, y], [x + width, y + height]]).astype(np.float32)
        if not np.isfinite(ends).all():
            raise ValueError("a coordinate is not finite in float32.")
        columns, u = _pixels(ends[:, 0], self._context.width)
        rows, v = _pixels(ends[:, 1], self._context.height)
        if len(columns) == 0 or len(rows) == 0:
            return
        display = self._context.display
        display.budget.charge("steps", len(columns) * len(rows))
        # Rows are sampled in blocks. Once there are more rectangles than the budget allows, no more
        # rows are sampled, since `add_pixels` will raise.
        block_rows = max(_PIXELS_AT_ONCE // len(columns), 1)
        rectangles, colors, count = [], [], 0
        for start in range(0, len(rows), block_rows):
            block = slice(start, start + block_rows)
            sampled = _bilinear(picture, u, v[block])
            runs, run_colors = _merge_runs(rows[block], columns, sampled)
            rectangles.append(runs)
            colors.append(np.pad(run_colors, ((0, 0), (0, 1)), constant_values=1.0))
            count += len(runs)
            if 2 * count > MAX_TRIANGLES:
                break
        display.add_pixels(np.concatenate(rectangles), np.concatenate(colors))

    def _frame(self, map3: np.ndarray) -> None:
        """Draw the outline of the drawing with black lines one pixel wide, as the course does.

        The drawing has the size that the root declares, and `map3` maps the root's user units to
        pixels. The lines run a pixel outside the left and right edge of the drawing, and a pixel
        inside its top and bottom edge.
        """
        height, width = self._size
        corners = affine_maps.apply(map3, [[0, 0], [width, 0], [0, height], [width, height]])
        offsets = np.array([[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        top_left, top_right, bottom_left, bottom_right = corners + offsets
        starts = np.array([top_left, top_left, bottom_right, bottom_right])
        ends = np.array([top_right, bottom_left, top_right, bottom_left])
        self._lines(starts, ends, (0.0, 0.0, 0.0, 1.0))


def _is_silent(tag: str, attributes: Attributes) -> bool:
    """Whether an element is left out without a warning.

    These are elements with a namespace prefix, `title`, `desc` and `metadata`, and the elements
    that `write_svg` adds for browsers alone, which have the attribute `data-fallback`.
    """
    return ":" in tag or tag in SILENT or FALLBACK in attributes


def _numbers(attributes: Attributes, name: str, count: int) -> Float[np.ndarray, " {count}"]:
    """Parse the first `count` numbers of the attribute `name`, which blanks separate.

    Raises `ValueError` if the attribute has fewer numbers.
    """
    try:
        numbers = blank_separated(attributes.get(name, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) < count:
        raise ValueError(
            f"{name}: expected {count} numbers with blanks between, got {len(numbers)}."
        )
    return np.array(numbers[:count])


def _pixels(
    ends: Float32[np.ndarray, "2"], side: int
) -> tuple[Float[np.ndarray, " pixels"], Float[np.ndarray, " pixels"]]:
    """Find the pixels that a picture covers along one axis of the canvas.

    - `ends`: where the picture begins and ends on this axis, in pixels.
    - `side`: size of the canvas along this axis, in pixels.

    Returns the indices of the pixels that lie on the canvas, and for each the texture coordinate of
    its centre: 0..1, or slightly less than 0 for the first pixel. Both arrays are empty for a
    picture that is mirrored or off the canvas.
    """
    low, high = float(ends[0]), float(ends[1])
    first, last = max(np.floor(low), 0.0), min(np.floor(high), side - 1.0)
    if high < low or last < first:
        return np.zeros(0), np.zeros(0)
    pixels = np.arange(int(first), int(last) + 1, dtype=np.float64)
    return pixels, (pixels + 0.5 - low) / (high - low + 1.0)


def _bilinear(
    picture: Float[np.ndarray, "picture_height picture_width 3"],
    u: Float[np.ndarray, " columns"],
    v: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "rows columns 3"]:
    """Sample a picture at every pair of `u` and `v`, bilinearly between the four texels around it.

    Texture coordinates 0 and 1 are the centres of the first and last texel, as in the course.
    """
    height, width = picture.shape[:2]
    x, y = u * (width - 1), v * (height - 1)
    left, top = np.floor(x), np.floor(y)
    columns = [np.clip(left + k, 0, width - 1).astype(np.int64) for k in (0, 1)]
    rows = [np.clip(top + k, 0, height - 1).astype(np.int64) for k in (0, 1)]
    x_weight, y_weight = (x - left)[None, :, None], (y - top)[:, None, None]
    upper, lower = (
        picture[row][:, columns[0]] * (1 - x_weight) + picture[row][:, columns[1]] * x_weight
        for row in rows
    )
    return upper * (1 - y_weight) + lower * y_weight


def _merge_runs(
    rows: Float[np.ndarray, " rows"],
    columns: Float[np.ndarray, " columns"],
    colors: Float[np.ndarray, "rows columns 3"],
) -> tuple[Float[np.ndarray, "rectangles 4"], Float[np.ndarray, "rectangles 3"]]:
    """Merge runs of equal colour in each row of pixels into rectangles one pixel high.

    `rows` and `columns` are the y and x of the pixels, as whole numbers, and `colors` their RGB.
    Returns the rectangles as (x0, y0, x1, y1) in pixels, with x1 and y1 exclusive, and the RGB of
    each.
    """
    starts_run = np.ones(colors.shape[:2], bool)
    starts_run[:, 1:] = (colors[:, 1:] != colors[:, :-1]).any(axis=-1)
    row, start = np.nonzero(starts_run)
    # A run ends where the next one of its row begins, or with the row.
    next_start = np.append(start[1:], len(columns))
    ends = np.where(next_start > start, next_start, len(columns))
    rectangles = np.stack([columns[start], rows[row], columns[ends - 1] + 1, rows[row] + 1], axis=1)
    return rectangles, colors[row, start]
