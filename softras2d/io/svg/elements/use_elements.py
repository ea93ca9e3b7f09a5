"""Resolves `use` elements: which element is drawn a second time, and with which map."""

from ....geometry import affine_maps
from ..css.cascade import Declarations
from ..xml.notices import INVALID, NOT_DRAWN
from ..xml.tree import Element
from .inherited_state import InheritedState, Instance
from .page import Page
from .shape_elements import ElementLengths


def instantiate(
    page: Page, use: Element, declared: Declarations, state: InheritedState
) -> tuple[InheritedState, Element] | None:
    """The state in which a `use` draws its target, and the target.

    - `declared`: declarations of the `use`.
    - `state`: state of the `use` itself, with its style and its map to pixels.

    The map in the result is a translation by `x` and `y` of the `use`, followed by the map of the
    `use`. Returns None for a `use` without `href`. It also returns None, and the fault is noted,
    for a reference that is broken, or that leads to an ancestor or to an element of which an
    instance is being drawn already.
    """
    report = page.report(use)
    href = use.attrib.get("href")
    target = page.target(href)
    if target is None:
        if href is not None:
            is_local = href.strip().startswith("#")
            kind = INVALID if is_local else NOT_DRAWN
            report(kind, "href", f"refers to no element of the file ({href[:40]!r})")
        return None
    instance, depth = state.instance, 0
    while instance is not None:
        depth += 1
        if instance.target is target:
            report(INVALID, "href", "refers to itself")
            return None
        instance = instance.outer
    page.budget.charge("copies", depth)
    if state.instance is None:
        ancestors = list(use.ancestors)
        # Looking at an ancestor takes no longer than testing a selector.
        page.budget.charge("selector_tests", len(ancestors))
        if any(ancestor is target for ancestor in ancestors):
            report(INVALID, "href", "refers to an ancestor")
            return None
    lengths = ElementLengths(page, use, declared, state.style)
    moved = affine_maps.translate(lengths.read("x"), lengths.read("y"))
    return (
        state._replace(
            placement=state.placement.with_map(state.placement.map3 @ moved),
            instance=Instance(target, use, state.instance),
        ),
        target,
    )
