"""Draws standard SVG, and the course's additional elements `colortri`, `textri` and `texture`.

It is the dialect `"svg"` of `read_svg`. Elements are visited in document order with an explicit
stack, since documents may be nested deeply. Invalid values are handled as SVG 2 prescribes, and
each is reported in the warning of the document.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..canvas.placement import make_placement
from ..canvas.sinks import Canvas, Layer, Sink
from ..css.cascade import Declarations
from ..css.style import INITIAL
from ..elements.clip_paths import ClipPaths
from ..elements.context import FALLBACK
from ..elements.element_kinds import (
    CONTAINERS,
    EXTENSIONS,
    NEVER_DRAWN,
    NOT_SUPPORTED,
    drawn_children_of_switch,
    is_drawable,
    meets_conditions,
    report_animations,
)
from ..elements.inherited_state import InheritedState
from ..elements.page import Page
from ..elements.shape_elements import SHAPES, ElementLengths
from ..elements.use_elements import instantiate
from ..elements.user_space_bounds import bounds_of, map_of_element
from ..elements.view_box import Box
from ..elements.viewports import nested_state, root_viewport
from ..painting.extensions import draw_extension
from ..painting.page_background import becomes_background, paint_root_background
from ..painting.painter import Painter, paints_both
from ..xml.document import LIBRARY_ERRORS, SvgError, reason
from ..xml.notices import APPROXIMATE, INVALID, NOT_DRAWN, WITHOUT_EFFECT
from ..xml.tree import Element


class _ElementStep(NamedTuple):
    """A step that draws an element, with the state that the element inherits from its parent."""

    element: Element
    state: InheritedState


class _GroupEnd(NamedTuple):
    """A step that composites a group, after all of its shapes have been drawn into a layer.

    - `element`: the group, or a shape with an opacity whose fill and stroke form a group.
    - `layer`: the shapes of the group.
    - `sink`: receives the composited group.
    - `opacity`: opacity of the group, in 0..1.
    """

    element: Element
    layer: Layer
    sink: Sink
    opacity: float


class Drawing:
    """Draws the elements of a document; its shapes are added to the display list of `page`.

    - `page`: the document, its style sheets, and the state of reading it.
    - `painter`: fills and strokes shapes. If its `keeps_sources` is set before `draw`, it stores
      the filled paths.
    - `canvas`: the sink that receives the painted shapes and adds them to the display list.
    """

    def __init__(self, page: Page):
        self._page = page
        self._context = page.context
        self._clips = ClipPaths(page)
        self.painter = Painter(page)
        self.canvas = Canvas(page.context.display)
        self._pending: list[_ElementStep | _GroupEnd] = []
        self._root_box = Box(0.0, 0.0, 0.0, 0.0)

    @property
    def root(self) -> Element:
        """The root of the document."""
        return self._page.root

    def draw(self) -> None:
        """Draw all elements of the document, which is done once.

        Raises `SvgError`, which names the line of the element that cannot be drawn.
        """
        self._guarded(self.root, self._begin)
        while self._pending:
            step = self._pending.pop()
            if isinstance(step, _GroupEnd):
                self._guarded(step.element, lambda step=step: self._close(step))
            else:
                self._guarded(step.element, lambda step=step: self._open(step))

    def _guarded(self, element: Element, action: Callable[[], None]) -> None:
        """Run an action; turn its errors into `SvgError`s that name the document and the element.

        The errors give the line number of `element` and its tag. An `SvgError` is passed on
        unchanged. The line is also set in the display list, which stores it with each shape that
        the action adds.
        """
        self._context.display.line = element.line
        try:
            action()
        except SvgError:
            raise
        except (ValueError, *LIBRARY_ERRORS) as error:
            where = f"{self._context.name}:{element.line}: <{element.tag[:60]}>"
            raise SvgError(f"{where} {reason(error)}") from None

    def _begin(self) -> None:
        """Fit the drawing into the canvas, paint its background, and put the root on the stack.

        If the root's map to pixels is singular, the root is not put there, so only the background
        is drawn.
        """
        page = self._page
        root = root_viewport(page)
        self._root_box = root.box
        page.viewport = root.viewport
        style = page.style_in_document(page.root)
        viewport = root.viewport._replace(root_font_size=style.font_size)
        paint_root_background(page, style, self.canvas)
        if np.linalg.det(root.map3) == 0:
            return
        placement = make_placement(root.map3, None, self.canvas)
        self._pending.append(_ElementStep(page.root, InheritedState(INITIAL, placement, viewport)))

    def _open(self, step: _ElementStep) -> None:
        """Draw a shape, declare a texture, or put the children of a group on the stack.

        Skipped without a notice are elements of other namespaces, elements that never draw anything
        or are for browsers alone, elements whose conditions fail or whose `display` is `none`,
        elements with an opacity of 0 or a singular transform, and `symbol` unless a `use` refers to
        it. Elements that are not supported, and elements of names that SVG does not define, are
        skipped too, but reported. Textures inside a `defs` are declared.
        """
        element, parent = step
        self._page.budget.charge("elements" if parent.instance is None else "copies", 1)
        self._page.viewport = parent.viewport
        name = element.name
        if name == "texture":
            self._context.declare_texture(element.attrib)
            return
        if name == "defs":
            self._declare_textures(element)
            report_animations(self._page, element)
        if name == "" or name in NEVER_DRAWN or FALLBACK in element.attrib:
            return
        if name == "symbol" and not parent.is_instance(element):
            return
        declared = self._page.declared(element)
        if not meets_conditions(element):
            return
        ineffective = ()
        if "mix-blend-mode" in declared.css and self._has_no_backdrop(element, parent):
            ineffective = ("mix-blend-mode",)
        style = self._page.displayed(element, parent.style, declared, ineffective)
        if style is None:
            return
        if not is_drawable(name):
            # Names that SVG does not define are not drawn by any program.
            self._page.not_drawn(NOT_DRAWN if name in NOT_SUPPORTED else INVALID, element)
            return
        use = parent.use_of(element)
        map3 = parent.placement.map3
        if element is not self.root:
            map3 = map_of_element(self._page, element, declared, style, map3, use)
        opacity = style.opacity if self._context.opacity else 1.0
        is_singular = map3 is not parent.placement.map3 and np.linalg.det(map3) == 0
        if is_singular or opacity == 0:
            return
        placement = parent.placement.with_map(map3)
        if style.clip_path is not None:
            needs_box = self._clips.needs_box(style)
            box = bounds_of(self._page, element, style, use) if needs_box else None
            clip = self._clips.clipped(element, style, map3, box, placement.clip)
            placement = placement._replace(clip=clip)
        state = parent._replace(style=style, placement=placement)
        if name in CONTAINERS:
            self._open_group(element, declared, state, opacity)
        else:
            self._draw_shape(element, declared, state, opacity)

    def _has_no_backdrop(self, element: Element, parent: InheritedState) -> bool:
        """Whether nothing that may be drawn precedes an element in its parent, an isolated `g`.

        The `g` has `isolation: isolate`. If so, nothing lies below the element in its group, and
        its blend mode has no effect. The result is False for an element that is drawn because a
        `use` refers to it.
        """
        group = element.parent
        if group is None or group.name != "g" or parent.is_instance(element):
            return False
        if self._page.declared(group).css.get("isolation", "").strip() != "isolate":
            return False
        for index in reversed(range(element.index)):
            name = group.children[index].name
            if name and name not in NEVER_DRAWN:
                return False
        return True

    def _declare_textures(self, element: Element) -> None:
        """Store the names and files of `texture` elements that are direct children of an element.

        Elements drawn later may refer to these textures by name.
        """
        for child in element.children:
            if child.name == "texture":
                self._context.display.line = child.line
                self._context.declare_texture(child.attrib)

    def _open_group(
        self, element: Element, declared: Declarations, state: InheritedState, opacity: float
    ) -> None:
        """Put the children of a group on the stack.

        - `declared`: declarations of the group.
        - `state`: state that the children inherit.
        - `opacity`: opacity of the group, in 0..1. If it is below 1, a `_GroupEnd` is put on the
          stack below the children, so that it is taken after them.

        The child of a `use` is the instance that it makes. Of a `switch`, only the children to draw
        are put on the stack.
        """
        if opacity < 1:
            layer = Layer(self._page.budget)
            self._pending.append(_GroupEnd(element, layer, state.placement.sink, opacity))
            state = state._replace(placement=state.placement._replace(sink=layer))
        children = element.children
        if element.name == "use":
            instance = instantiate(self._page, element, declared, state)
            if instance is None:
                return
            state, children = instance[0], [instance[1]]
        elif element.name in ("svg", "symbol") and element is not self.root:
            nested = nested_state(self._page, element, declared, state)
            if nested is None:
                return
            state = nested
        elif element.name == "switch":
            children = drawn_children_of_switch(element)
        self._pending += [_ElementStep(child, state) for child in reversed(children)]

    def _close(self, group: _GroupEnd) -> None:
        """Composite the shapes of a group; report if the resulting colours are approximate."""
        if not group.layer.finish(group.sink, group.opacity):
            self._page.report(group.element)(
                APPROXIMATE, "opacity", "translucent shapes overlap in it"
            )

    def _draw_shape(
        self, element: Element, declared: Declarations, state: InheritedState, opacity: float
    ) -> None:
        """Draw a shape, or make it the background of the scene (`becomes_background`).

        Child elements that are not supported are reported, and textures among them are declared.

        - `declared`: declarations of the shape.
        - `state`: state of the shape itself, with its style and placement.
        - `opacity`: opacity of the shape, in 0..1. If it is below 1, it applies to the result of
          compositing the fill and the stroke.
        """
        for child in element.children:
            if child.name in NOT_SUPPORTED:
                self._page.not_drawn(NOT_DRAWN, child)
            elif child.name == "texture":
                self._context.declare_texture(child.attrib)
        lengths = ElementLengths(self._page, element, declared, state.style)
        placement, style = state.placement, state.style
        if element.name in EXTENSIONS:
            if style.visibility == "visible":
                draw_extension(self._page, element, lengths, placement, style, opacity)
            return
        path = SHAPES[element.name](lengths)
        if path is None or not path.points:
            return
        is_plain_rect = element.name == "rect" and opacity == 1 and style.visibility == "visible"
        if is_plain_rect and becomes_background(self._page, path, style, placement, self._root_box):
            return
        if opacity < 1 and paints_both(style):
            layer = Layer(self._page.budget)
            self.painter.paint(element, path, style, placement._replace(sink=layer), 1.0)
            self._close(_GroupEnd(element, layer, placement.sink, opacity))
        else:
            self.painter.paint(element, path, style, placement, opacity)
        if style.stroke_linejoin == "arcs" and style.stroke is not None:
            self._page.report(element)(WITHOUT_EFFECT, "stroke-linejoin", "drawn as miter")
