"""Draws standard SVG, and the course's additional elements `colortri`, `textri` and `texture`.

It is the dialect `"svg"` of `read_svg`.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...geometry import affine_maps
from ..shapes.strokes import Outline
from .context import Context
from .document import Attributes
from .numbers import length, number_list
from .style import INITIAL, Rgba, Style, computed
from .transform_attribute import transform_list
from .view_box import Box, document_size, fit, round_up, view_box

_SVG = "http://www.w3.org/2000/svg"


class _State(NamedTuple):
    """What an element passes on to its children.

    - `map3`: homogeneous map `[3, 3]` from the element's units to pixels.
    - `is_flat`: whether `map3` maps the plane to a line or a point.
    - `scale`: largest stretch of `map3`, in pixels per unit.
    """

    style: Style
    map3: np.ndarray
    is_flat: bool
    scale: float

    @staticmethod
    def of(style: Style, map3: np.ndarray) -> "_State":
        """The state with a style and a map; `ValueError` if the map is not finite."""
        if not np.isfinite(map3).all():
            raise ValueError("transform: the numbers are too large.")
        stretch = float(np.linalg.norm(map3[:2, :2], 2) / abs(map3[2, 2] or 1.0))
        return _State(style, map3, bool(np.linalg.det(map3) == 0.0), stretch)


class StandardDialect:
    """Draws elements with their meaning in SVG.

    A group's opacity is multiplied into that of its children. This differs from blending the
    finished group where its children overlap. A transform that flattens the plane draws nothing.
    """

    groups = frozenset({"a", "g"})
    definitions = frozenset({"defs"})

    def __init__(self, context: Context):
        self._context = context
        self._namespaces: Attributes = {}
        self._box = Box(0.0, 0.0, 0.0, 0.0)
        self._diagonal = 0.0
        self.shapes = {
            "colortri": self._colortri,
            "image": self._image,
            "line": self._line,
            "polygon": self._polygon,
            "polyline": self._polyline,
            "rect": self._rect,
            "textri": self._textri,
        }

    def local_name(self, tag: str, attributes: Attributes) -> str:
        """The name without a prefix whose namespace is SVG; empty for other prefixes.

        The element itself or the root must declare the prefix. Names without prefix count as SVG,
        whatever the default namespace is.
        """
        prefix, colon, name = tag.rpartition(":")
        if not colon:
            return name
        declaration = f"xmlns:{prefix}"
        namespace = attributes.get(declaration, self._namespaces.get(declaration))
        return name if namespace == _SVG else ""

    def root_state(self, tag: str, attributes: Attributes) -> _State | None:
        """Fit the viewBox into the canvas."""
        self._namespaces = {k: v for k, v in attributes.items() if k.startswith("xmlns:")}
        if self.local_name(tag, attributes) != "svg":
            raise ValueError("is the root, which must be <svg>.")
        context = self._context
        size = document_size(attributes, "svg")
        box = view_box(attributes)
        if box is None:
            height, width = size or (float(context.height), float(context.width))
            box = Box(0.0, 0.0, width, height)
        self._box = box
        map3 = context.transform
        if map3 is None:
            height, width = float(context.height), float(context.width)
            if size is not None and round_up(size) == (context.height, context.width):
                # The canvas has the document's size, rounded up: do not stretch to the rounding.
                height, width = size
            map3 = fit(box, height, width, attributes.get("preserveAspectRatio", ""))
        # 100 % of a length that is neither horizontal nor vertical (SVG 2, section 8.9).
        self._diagonal = math.hypot(box.width, box.height) / math.sqrt(2.0)
        return self.child_state(_State.of(INITIAL, map3), attributes)

    def child_state(self, parent: _State, attributes: Attributes) -> _State | None:
        """Apply the element's style and transform to those of its parent."""
        style = computed(attributes, parent.style, self._diagonal, self._ignore)
        state = parent._replace(style=style)
        if "transform" in attributes:
            state = _State.of(style, parent.map3 @ transform_list(attributes["transform"]))
        return None if style.display == "none" else state

    def is_flat(self, state: _State) -> bool:
        """Whether the map to pixels has no inverse."""
        return state.is_flat

    def undrawn_child(self, name: str, attributes: Attributes) -> None:
        """Declare a texture; count elements that would not be supported elsewhere either."""
        if name == "texture":
            self._context.declare_texture(attributes)
        elif not (name in self.shapes or name in self.groups or name in self.definitions):
            self._context.elements[name] += 1

    def close_root(self, state: _State) -> None:
        """Nothing is drawn after the elements."""

    def _ignore(self, name: str) -> None:
        self._context.ignored[name] += 1

    def _length(self, attributes: Attributes, name: str, default: float = 0.0) -> float:
        """Parse a length attribute, in user units; `default` if it is missing or `auto`."""
        if name not in attributes or attributes[name].strip() == "auto":
            return default
        along_x = name in ("x", "x1", "x2", "width")
        try:
            return length(attributes[name], self._box.width if along_x else self._box.height)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None

    def _rect(self, state: _State, attributes: Attributes) -> None:
        box = Box(*(self._length(attributes, name) for name in ("x", "y", "width", "height")))
        if any(name in attributes and self._length(attributes, name) != 0 for name in ("rx", "ry")):
            self._ignore("rx or ry of rect")
        if box.width < 0 or box.height < 0:
            self._ignore("rect of negative size")
        if box.width <= 0 or box.height <= 0:
            return
        points = _box_corners(box)
        fill = state.style.fill_rgba(self._context.opacity)
        if fill is not None and self._becomes_background(state, box, points, fill):
            self._context.background = fill[:3]
            return
        self._fill(state, points)
        self._stroke(state, points, closed=True)

    def _becomes_background(self, state: _State, box: Box, points: np.ndarray, fill: Rgba) -> bool:
        """Whether a rect is the first shape, opaque, and covers the viewBox and the canvas.

        A viewBox may leave margins on the canvas. They show the page, not the rect, so a rect that
        covers the viewBox alone is no background.
        """
        context = self._context
        if (
            len(context.display)
            or context.background
            or fill[3] < 1
            or not _fits_float32(fill)
            or box != self._box
        ):
            return False
        if state.style.stroke_rgba(context.opacity) is not None:
            return False
        corners = affine_maps.apply(state.map3, points)
        x0, y0 = corners.min(axis=0)
        x1, y1 = corners.max(axis=0)
        is_upright = all(len(set(axis.round(9))) == 2 for axis in corners.T)
        tolerance = 1e-6 * max(context.height, context.width)
        return bool(
            is_upright
            and max(x0, y0) <= tolerance
            and x1 >= context.width - tolerance
            and y1 >= context.height - tolerance
        )

    def _polygon(self, state: _State, attributes: Attributes) -> None:
        points = self._points(attributes)
        self._fill(state, points)
        self._stroke(state, points, closed=True)

    def _polyline(self, state: _State, attributes: Attributes) -> None:
        points = self._points(attributes)
        self._fill(state, points)
        self._stroke(state, points, closed=False)

    def _line(self, state: _State, attributes: Attributes) -> None:
        ends = [self._length(attributes, name) for name in ("x1", "y1", "x2", "y2")]
        self._stroke(state, np.array(ends).reshape(2, 2), closed=False)

    def _points(self, attributes: Attributes) -> np.ndarray:
        numbers = number_list(attributes.get("points", ""))
        if len(numbers) % 2:
            # SVG draws what comes before an error in the list.
            self._ignore("last of an odd number of coordinates")
            numbers.pop()
        return np.array(numbers, np.float64).reshape(-1, 2)

    def _fill(self, state: _State, points: np.ndarray) -> None:
        color = state.style.fill_rgba(self._context.opacity)
        if color is not None and len(points) > 2:
            evenodd = state.style.fill_rule == "evenodd"
            self._context.display.add_polygon(affine_maps.apply(state.map3, points), color, evenodd)

    def _stroke(self, state: _State, points: np.ndarray, *, closed: bool) -> None:
        style = state.style
        color = style.stroke_rgba(self._context.opacity)
        if color is None or len(points) == 0:
            return
        outline = Outline(
            points,
            closed,
            style.stroke_width,
            style.stroke_linecap,
            style.stroke_linejoin,
            style.stroke_miterlimit,
            state.scale,
        )
        self._context.display.add_stroke(outline, state.map3, color)

    def _colortri(self, state: _State, attributes: Attributes) -> None:
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        colors = _numbers(attributes, "colors", 12).reshape(3, 4)
        if not ((colors[:, 3] >= 0) & (colors[:, 3] <= 1)).all():
            raise ValueError(f"colors: alpha must be in 0..1, got {attributes['colors']!r}.")
        white = self._white(state)
        if white is not None:
            if not self._context.opacity:
                colors[:, 3] = 1.0
            self._context.display.add_triangles(
                affine_maps.apply(state.map3, points)[None], colors * white
            )

    def _textri(self, state: _State, attributes: Attributes) -> None:
        points = _numbers(attributes, "points", 6).reshape(3, 2)
        uv = _numbers(attributes, "uvs", 6).reshape(3, 2)
        texture = self._context.assets.texture(attributes.get("texid", ""))
        white = self._white(state)
        if white is not None:
            corners = affine_maps.apply(state.map3, points)
            self._context.display.add_textured(corners, white, uv, texture, False)

    def _white(self, state: _State) -> Rgba | None:
        """White with the opacities of the element; None if it is hidden."""
        style = state.style._replace(fill=(1.0, 1.0, 1.0, 1.0))
        return style.fill_rgba(self._context.opacity)

    def _image(self, state: _State, attributes: Attributes) -> None:
        href = attributes.get("href", attributes.get("xlink:href"))
        if href is None:
            self._ignore("image without href")
            return
        assets = self._context.assets
        texture = assets.linked(href)
        picture_height, picture_width = map(float, assets.textures[texture].shape[:2])
        width = self._length(attributes, "width", math.inf)
        height = self._length(attributes, "height", math.inf)
        if width <= 0 or height <= 0:
            return
        # Infinity stands for `auto`: the side follows from the picture (SVG 2, section 12.3).
        if width == math.inf:
            is_auto = height == math.inf
            width = picture_width if is_auto else height * picture_width / picture_height
        if height == math.inf:
            height = width * picture_height / picture_width
        to_viewport = fit(
            Box(0.0, 0.0, picture_width, picture_height),
            height,
            width,
            attributes.get("preserveAspectRatio", ""),
        )
        # With `slice`, the picture reaches beyond the viewport, which clips it. Texture coordinates
        # are fractions of the picture.
        low, high = affine_maps.apply(to_viewport, [[0.0, 0.0], [picture_width, picture_height]])
        start, end = np.maximum(low, 0.0), np.minimum(high, [width, height])
        uv = _box_corners(Box(*((start - low) / (high - low)), *((end - start) / (high - low))))
        origin = np.array([self._length(attributes, "x"), self._length(attributes, "y")])
        points = affine_maps.apply(state.map3, _box_corners(Box(*(origin + start), *(end - start))))
        # `fill-opacity` does not apply to images.
        white = self._white(state._replace(style=state.style._replace(fill_opacity=1.0)))
        if white is not None:
            translucent = white[3] < 1 or assets.textures[texture].shape[-1] == 4
            self._context.display.add_textured(points, white, uv, texture, translucent)


def _numbers(attributes: Attributes, name: str, count: int) -> Float[np.ndarray, " {count}"]:
    """Parse an attribute of exactly `count` numbers."""
    try:
        numbers = number_list(attributes.get(name, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) != count:
        raise ValueError(f"{name}: expected {count} numbers, got {len(numbers)}.")
    return np.array(numbers)


def _fits_float32(color: Rgba) -> bool:
    """Whether all channels of a colour are finite in float32.

    Other colours are drawn as shapes, so that the error names their line.
    """
    return all(abs(value) <= np.finfo(np.float32).max for value in color)


def _box_corners(box: Box) -> Float[np.ndarray, "4 2"]:
    """Corners in the order top left, top right, bottom right, bottom left."""
    x, y = box.x, box.y
    return np.array(
        [[x, y], [x + box.width, y], [x + box.width, y + box.height], [x, y + box.height]]
    )
