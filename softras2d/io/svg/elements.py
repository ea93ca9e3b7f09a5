"""States the interface of SVG elements and dialects: from attributes to shapes.

A **shape function** draws one kind of element. It receives the attributes of the element and the
state inherited from its ancestors (style and map to pixels), and adds shapes to the display list.
It raises `ValueError` for attributes that cannot be parsed.

A **dialect** (`svg_dialect.py`, `course_dialect.py`) has a table from element names to shape
functions, and defines how state is inherited. `ElementReader` does what both dialects share: it
enters groups, declares textures, and counts elements that are not supported. To add an element to a
dialect, write its shape function and add one line to the table.
"""

from collections.abc import Callable, Mapping
from typing import Generic, Protocol, TypeVar, runtime_checkable

from .context import FALLBACK, SILENT, Context
from .document import Attributes, Children

State = TypeVar("State")
"""What children inherit from an element, such as style and map to pixels."""

ShapeFunction = Callable[[State, Attributes], None]


@runtime_checkable
class Dialect(Protocol[State]):
    """Defines what elements mean in one dialect, while one document is read."""

    @property
    def shapes(self) -> Mapping[str, ShapeFunction[State]]:
        """The table of shape functions, by the local name of the element."""
        ...

    @property
    def groups(self) -> frozenset[str]:
        """Elements that draw nothing themselves and pass their state on to their children."""
        ...

    @property
    def definitions(self) -> frozenset[str]:
        """Elements whose children are not drawn, but may declare textures."""
        ...

    def local_name(self, tag: str, attributes: Attributes) -> str:
        """The name of an element without its prefix; empty if its namespace is not SVG."""
        ...

    def root_state(self, tag: str, attributes: Attributes) -> State | None:
        """The state of the root; None if it is not displayed. `ValueError` if it is no `<svg>`."""
        ...

    def child_state(self, parent: State, attributes: Attributes) -> State | None:
        """The state of an element inside one of state `parent`; None if it is not displayed."""
        ...

    def is_flat(self, state: State) -> bool:
        """Whether shapes are not drawn because the map to pixels flattens the plane."""
        ...

    def undrawn_child(self, name: str, attributes: Attributes) -> None:
        """Declare or count a child of a definition, of a shape, or of a texture."""
        ...

    def close_root(self, state: State) -> None:
        """Draw what comes after all elements."""
        ...


class ElementReader(Generic[State]):
    """Reads a document in one dialect, as the `document.Reader` that `walk` calls."""

    def __init__(self, dialect: Dialect[State], context: Context):
        self._dialect = dialect
        self._context = context
        # One state for the root, and one for each open group.
        self._states: list[State] = []

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """Draw a shape, or enter the root or a group."""
        self._context.display.line = line
        if not self._states:
            return self._enter(self._dialect.root_state(tag, attributes))
        name = self._dialect.local_name(tag, attributes)
        if _is_silent(name, attributes):
            return Children.SKIPPED
        if name in self._dialect.definitions:
            return Children.NAMED
        if name == "texture":
            self._context.declare_texture(attributes)
            return Children.NAMED
        if name not in self._dialect.shapes and name not in self._dialect.groups:
            self._context.elements[name] += 1
            return Children.SKIPPED
        state = self._dialect.child_state(self._states[-1], attributes)
        if state is None or name in self._dialect.groups:
            return self._enter(state)
        if not self._dialect.is_flat(state):
            self._dialect.shapes[name](state, attributes)
        return Children.NAMED

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """Handle a child of an element whose children are not drawn."""
        name = self._dialect.local_name(tag, attributes)
        if not _is_silent(name, attributes):
            self._dialect.undrawn_child(name, attributes)

    def close(self) -> None:
        """Leave a group or the root."""
        state = self._states.pop()
        if not self._states:
            self._dialect.close_root(state)

    def _enter(self, state: State | None) -> Children:
        if state is None:
            return Children.SKIPPED
        self._states.append(state)
        return Children.READ


def _is_silent(name: str, attributes: Attributes) -> bool:
    """Whether an element is left out without a warning."""
    return name == "" or name in SILENT or FALLBACK in attributes
