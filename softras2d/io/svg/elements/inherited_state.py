"""Holds what an element passes on to its children as they are drawn."""

from typing import NamedTuple

from ..canvas.placement import Placement
from ..css.style import Style
from ..values.units import Viewport
from ..xml.tree import Element


class Instance(NamedTuple):
    """A copy of an element that is being drawn.

    - `target`: the element; `use`: the element `use` that asks for the copy.
    - `outer`: the copy inside of which this one is drawn, or None.
    """

    target: Element
    use: Element
    outer: "Instance | None"


class InheritedState(NamedTuple):
    """Style, placement and viewport that an element passes on to its children.

    - `viewport`: sizes to which their lengths are relative.
    - `instance`: the innermost copy of which they are a part; None outside of all copies.
    """

    style: Style
    placement: Placement
    viewport: Viewport
    instance: Instance | None = None

    def is_instance(self, element: Element) -> bool:
        """Whether an element is the target of the innermost `use`, rather than its descendant."""
        return self.instance is not None and self.instance.target is element

    def use_of(self, element: Element) -> Element | None:
        """The `use` that asks for an instance of this element; None if it is drawn in its place."""
        return self.instance.use if self.instance and self.is_instance(element) else None
