"""Draws standard SVG, and the course's additional elements `colortri`, `textri` and `texture`.

It is the dialect `"svg"` of `read_svg`. Elements are visited in document order with an explicit
stack, since documents may be nested deeply. What has an error is left out as SVG 2 says, and noted.
"""

import contextlib
from typing import Any, NamedTuple

import numpy as np
import shapely

from ...geometry import affine_maps
from ..shapes.regions import intersection
from .cascade import Declarations
from .clip_paths import ClipPaths
from .css_color import CURRENT
from .document import LIBRARY_ERRORS, SvgError, reason
from .element_transform import element_transform
from .extensions import draw_colortri, draw_image, draw_textri
from .notices import APPROXIMATE, INVALID, NOT_DRAWN, WITHOUT_EFFECT
from .page import Page
from .page_background import becomes_background
from .painting import Painter, Place
from .shape_elements import SHAPES, ElementLengths
from .sinks import Canvas, Layer, Sink
from .style import INITIAL, Style
from .tree import Element
from .units import Viewport
from .user_space_bounds import bounds_of
from .view_box import Box, document_size, fit, round_up, view_box

_EXTENSIONS = {"colortri": draw_colortri, "image": draw_image, "textri": draw_textri}

_CONTAINERS = frozenset({"a", "g", "svg", "switch", "symbol", "use"})

_NEVER_DRAWN = frozenset(
    # Elements that draw nothing where they are.
    [
        "clipPath",
        "defs",
        "desc",
        "filter",
        "linearGradient",
        "marker",
        "mask",
        "metadata",
        "pattern",
        "radialGradient",
        "script",
        "stop",
        "style",
        "title",
        "view",
        "cursor",
        "font",
        "font-face",
        "color-profile",
        "texture",
    ]
)

_NOT_SUPPORTED = frozenset(
    [
        "text",
        "foreignObject",
        "animate",
        "animateColor",
        "animateMotion",
        "animateTransform",
        "set",
        "audio",
        "canvas",
        "iframe",
        "video",
    ]
)

LANGUAGE = "en"
"""The language of the user, for `systemLanguage`."""


class _State(NamedTuple):
    """What an element passes on to its children.

    - `instances`: the elements of which `use` is drawing a copy, the innermost first, as a chain.
    """

    style: Style
    place: Place
    viewport: Viewport
    instances: tuple[Any, ...] | None = None


class _Close(NamedTuple):
    """The end of a group that is composited as a whole into `sink`."""

    element: Element
    layer: Layer
    sink: Sink
    opacity: float


class Drawing:
    """Draws the elements of a page."""

    def __init__(self, page: Page):
        self._page = page
        self._context = page.context
        self._clips = ClipPaths(page)
        self.painter = Painter(page)
        self.canvas = Canvas(page.context.display)
        self._pending: list[tuple[Element, _State] | _Close] = []
        self._box = Box(0.0, 0.0, 0.0, 0.0)

    @property
    def root(self) -> Element:
        """The root of the document."""
        return self._page.root

    def draw(self) -> None:
        """Draw the whole document. Raises `SvgError` with the line of the element."""
        root = self._page.root
        self._guarded(root, lambda: self._pending.append((root, self._root_state())))
        while self._pending:
            step = self._pending.pop()
            if isinstance(step, _Close):
                self._guarded(step.element, lambda step=step: self._close(step))
            else:
                self._guarded(step[0], lambda step=step: self._open(*step))

    def _guarded(self, element: Element, action: Any) -> None:
        """Run an action, whose errors get the name of the document, the line and the element."""
        self._context.display.line = element.line
        try:
            action()
        except SvgError:
            raise
        except (ValueError, *LIBRARY_ERRORS) as error:
            where = f"{self._context.name}:{element.line}: <{element.tag[:60]}>"
            raise SvgError(f"{where} {reason(error)}") from None

    def _root_state(self) -> _State:
        """Fit the viewBox into the canvas."""
        context, attributes = self._context, self._page.root.attrib
        canvas, box = (float(context.height), float(context.width)), None
        size = document_size(attributes, "svg", self._page.report(self._page.root))
        # An invalid viewBox is noted by `document_size`.
        with contextlib.suppress(ValueError):
            box = view_box(attributes)
        if box is None:
            height, width = size or canvas
            box = Box(0.0, 0.0, width, height)
        self._box = box
        map3 = context.transform
        if size is not None and round_up(size) == (context.height, context.width):
            # The canvas has the document's size, rounded up: do not stretch to the rounding.
            canvas = size
        if map3 is None:
            map3 = self._fitted(self._page.root, box, *canvas)
        height, width = size or canvas
        self._page.pixels_per_px = min(canvas[0] / height, canvas[1] / width)
        viewport = Viewport(box.width, box.height, width, height)
        self._page.viewport = viewport
        root_style = self._page.style_in_place(self._page.root)
        viewport = viewport._replace(root_font_size=root_style.font_size)
        self._paint_canvas(root_style)
        return _State(INITIAL, self._placed(map3, None, self.canvas), viewport)

    def _paint_canvas(self, style: Style) -> None:
        """Paint the canvas in the `background-color` of the root (CSS Backgrounds 3, 2.11.2)."""
        root = self._page.root
        css = self._page.declared(root).css
        for name in ("background", "background-image"):
            if any(function in css.get(name, "").lower() for function in ("url(", "gradient(")):
                self._page.report(root)(WITHOUT_EFFECT, name, "images are not drawn")
        color = style.background_color
        red, green, blue, alpha = style.color if color == CURRENT else color
        if alpha == 0:
            return
        alpha = alpha if self._context.opacity else 1.0
        if alpha == 1:
            self._context.background = (red, green, blue)
            return
        height, width = self._context.height, self._context.width
        corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
        self.canvas.add_polygon([corners], (red, green, blue, alpha), False, -1)

    def _fitted(self, element: Element, box: Box, height: float, width: float) -> np.ndarray:
        aspect = element.attrib.get("preserveAspectRatio", "")
        if element is self._page.root and self._context.fit is not None:
            aspect = self._context.fit
        try:
            return fit(box, height, width, aspect)
        except ValueError as error:
            self._page.report(element)(INVALID, "preserveAspectRatio", str(error))
            return fit(box, height, width)

    def _placed(self, map3: np.ndarray, clip: Any, sink: Sink) -> Place:
        """The place with a map; `ValueError` if the map is not finite."""
        if not np.isfinite(map3).all():
            raise ValueError("transform: the numbers are too large to be finite.")
        scale = float(np.linalg.norm(map3[:2, :2], 2) / abs(map3[2, 2] or 1.0))
        return Place(map3, scale, clip, sink)

    def _open(self, element: Element, parent: _State) -> None:
        """Draw a shape, or put the children of a group on the stack."""
        self._page.budget.charge("elements" if parent.instances is None else "copies", 1)
        self._page.viewport = parent.viewport
        name = element.name
        if name == "texture":
            self._context.declare_texture(element.attrib)
            return
        if name == "defs":
            self._declare_textures(element)
        if name == "" or name in _NEVER_DRAWN or "data-fallback" in element.attrib:
            return
        if name == "symbol" and (parent.instances is None or parent.instances[0] is not element):
            return
        declared = self._page.declared(element)
        style = self._page.computed(element, parent.style, declared)
        if style.display == "none" or not self._meets_conditions(element):
            return
        if name not in SHAPES and name not in _EXTENSIONS and name not in _CONTAINERS:
            # Names that SVG does not define are not drawn by any program.
            self._page.not_drawn(NOT_DRAWN if name in _NOT_SUPPORTED else INVALID, element)
            return
        map3 = self._transformed(element, declared, style, parent.place.map3)
        if np.linalg.det(map3) == 0:
            return
        opacity = style.opacity if self._context.opacity else 1.0
        if opacity == 0:
            return
        place = self._placed(map3, parent.place.clip, parent.place.sink)
        state = _State(style, place, parent.viewport, parent.instances)
        if style.clip_path is not None:
            box = bounds_of(self._page, element, style) if self._clips.needs_box(style) else None
            clip = self._clips.clipped(element, style, map3, box, place.clip)
            state = state._replace(place=place._replace(clip=clip))
        if name in _CONTAINERS:
            self._open_group(element, declared, state, opacity)
        else:
            self._draw_shape(element, declared, state, opacity)

    def _declare_textures(self, element: Element) -> None:
        for child in element.children:
            if child.name == "texture":
                self._context.display.line = child.line
                self._context.declare_texture(child.attrib)

    def _meets_conditions(self, element: Element) -> bool:
        """Whether the conditional attributes of an element hold (SVG 2, section 5.9)."""
        attributes = element.attrib
        if "requiredExtensions" in attributes:
            return False
        languages = attributes.get("systemLanguage")
        if languages is None:
            return True
        tags = [tag.strip().lower() for tag in languages.split(",")]
        return any(tag == LANGUAGE or tag.startswith(f"{LANGUAGE}-") for tag in tags)

    def _transformed(
        self, element: Element, declared: Declarations, style: Style, map3: np.ndarray
    ) -> np.ndarray:
        """The parent's map after the element's own transform."""
        own = element_transform(
            self._page, element, declared, style, lambda: bounds_of(self._page, element, style)
        )
        return map3 if own is None else map3 @ own

    def _open_group(
        self, element: Element, declared: Declarations, state: _State, opacity: float
    ) -> None:
        """Put the children of a group on the stack, after the end of the group if it needs one."""
        if opacity < 1:
            layer = Layer(self._page.budget)
            self._pending.append(_Close(element, layer, state.place.sink, opacity))
            state = state._replace(place=state.place._replace(sink=layer))
        children = element.children
        if element.name == "use":
            state, children = self._instance(element, declared, state)
        elif element.name in ("svg", "symbol") and element is not self._page.root:
            inner = self._nested_viewport(element, declared, state)
            if inner is None:
                return
            state = inner
        elif element.name == "switch":
            children = self._chosen(element)
        self._pending += [(child, state) for child in reversed(children)]

    def _close(self, group: _Close) -> None:
        """Composite a group."""
        if not group.layer.finish(group.sink, group.opacity):
            self._page.report(group.element)(
                APPROXIMATE, "opacity", "translucent shapes overlap in it"
            )

    def _chosen(self, element: Element) -> list[Element]:
        """The child of a `switch` that is drawn: the first whose conditions hold."""
        for child in element.children:
            is_known = (
                child.name in SHAPES or child.name in _CONTAINERS or child.name in _EXTENSIONS
                or child.name in _NOT_SUPPORTED
            )  # fmt: skip
            if is_known and self._meets_conditions(child):
                return [child]
        return []

    def _instance(
        self, element: Element, declared: Declarations, state: _State
    ) -> tuple[_State, list[Element]]:
        """The element that a `use` draws, and the state in which it draws it."""
        report = self._page.report(element)
        href = element.attrib.get("href")
        target = self._page.target(href)
        if target is None:
            if href is not None:
                is_local = href.strip().startswith("#")
                kind = INVALID if is_local else NOT_DRAWN
                report(kind, "href", f"refers to no element of the file ({href[:40]!r})")
            return state, []
        chain, depth = state.instances, 0
        while chain is not None:
            depth += 1
            if chain[0] is target:
                report(INVALID, "href", "refers to itself")
                return state, []
            chain = chain[1]
        self._page.budget.charge("copies", depth)
        if state.instances is None:
            ancestors = list(element.ancestors)
            # About as many steps as take the time of one test.
            self._page.budget.charge("selector_tests", len(ancestors))
            if any(ancestor is target for ancestor in ancestors):
                report(INVALID, "href", "refers to an ancestor")
                return state, []
        lengths = ElementLengths(self._page, element, declared, state.style)
        moved = affine_maps.translate(lengths.read("x"), lengths.read("y"))
        place = self._placed(state.place.map3 @ moved, state.place.clip, state.place.sink)
        return state._replace(place=place, instances=(target, state.instances, element)), [target]

    def _nested_viewport(
        self, element: Element, declared: Declarations, state: _State
    ) -> _State | None:
        """The state inside of a nested `svg` or an instance of a `symbol`; None if it has no area.

        **Source:** SVG 2, sections 5.5 and 8.2.
        """
        lengths = ElementLengths(self._page, element, declared, state.style)
        viewport = state.viewport
        width = lengths.size("width", viewport.width)
        height = lengths.size("height", viewport.height)
        x, y = lengths.read("x"), lengths.read("y")
        if state.instances is not None and state.instances[0] is element:
            # The size of `use` replaces that of its target.
            use = state.instances[2]
            use_lengths = ElementLengths(self._page, use, self._page.declared(use), state.style)
            width, height = use_lengths.size("width", width), use_lengths.size("height", height)
        if width <= 0 or height <= 0:
            return None
        map3 = state.place.map3 @ affine_maps.translate(x, y)
        clip = state.place.clip
        if state.style.overflow not in ("visible", "auto"):
            corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]
            clip = shapely.Polygon(affine_maps.apply(map3, corners))
            if state.place.clip is not None:
                clip = intersection(clip, state.place.clip, self._page.budget)
            shapely.prepare(clip)
        box = self._view_box(element)
        if box is not None:
            map3 = map3 @ self._fitted(element, box, height, width)
        inner = viewport._replace(
            width=box.width if box else width, height=box.height if box else height
        )
        place = self._placed(map3, clip, state.place.sink)
        return state._replace(place=place, viewport=inner)

    def _view_box(self, element: Element) -> Box | None:
        try:
            return view_box(element.attrib)
        except ValueError as error:
            self._page.report(element)(INVALID, "viewBox", str(error))
            return None

    def _draw_shape(
        self, element: Element, declared: Declarations, state: _State, opacity: float
    ) -> None:
        """Draw a shape, composited as a whole if it has an opacity."""
        for child in element.children:
            if child.name in _NOT_SUPPORTED:
                self._page.not_drawn(NOT_DRAWN, child)
            elif child.name == "texture":
                self._context.declare_texture(child.attrib)
        lengths = ElementLengths(self._page, element, declared, state.style)
        place, style = state.place, state.style
        if element.name in _EXTENSIONS:
            if style.visibility == "visible":
                _EXTENSIONS[element.name](self._page, element, lengths, place, style, opacity)
            return
        path = SHAPES[element.name](lengths)
        if path is None or not path.points:
            return
        is_plain_rect = element.name == "rect" and opacity == 1 and style.visibility == "visible"
        if is_plain_rect and becomes_background(self._page, path, style, place, self._box):
            return
        if opacity < 1 and self.painter.paints_both(style):
            layer = Layer(self._page.budget)
            self.painter.paint(element, path, style, place._replace(sink=layer), 1.0)
            self._close(_Close(element, layer, place.sink, opacity))
        else:
            self.painter.paint(element, path, style, place, opacity)
        if style.stroke_linejoin == "arcs" and style.stroke is not None:
            self._page.report(element)(WITHOUT_EFFECT, "stroke-linejoin", "drawn as miter")
