"""Defines the state that an element passes on to its children as they are drawn."""

from typing import NamedTuple

from ..canvas.placement import Placement
from ..css.style import Style
from ..values.units import Viewport
from ..xml.tree import Element


class Instance(NamedTuple):
    """A copy of an element that is being drawn because a `use` refers to the element.

    - `target`: the element that is copied.
    - `use`: the `use` element that refers to it.
    - `outer`: the instance inside of which this one is drawn; None for an outermost instance.
    """

    target: Element
    use: Element
    outer: "Instance | None"


class InheritedState(NamedTuple):
    """Style, placement and viewport that an element passes on to its children.

    - `style`: computed style of the element, from which children inherit.
    - `placement`: map from the children's user units to pixels, clip, and sink of their shapes.
    - `viewport`: sizes to which the children's lengths are relative.
    - `instance`: the innermost instance to which the children belong; None if no `use` draws them.
    """

    style: Style
    placement: Placement
    viewport: Viewport
    instance: Instance | None = None

    def is_instance(self, element: Element) -> bool:
        """Whether an element is the target of the innermost `use` that draws the children.

        False for descendants of the target, and for elements that no `use` draws.
        """
        return self.instance is not None and self.instance.target is element

    def use_of(self, element: Element) -> Element | None:
        """The innermost `use` that draws the children, if `element` is its target; None otherwise.

        The result is the element `use` itself.
        """
        return self.instance.use if self.instance and self.is_instance(element) else None
