"""Collects notices about what is not drawn as the standard says, for one warning at the end.

Every notice has a kind: `NOT_DRAWN`, `WITHOUT_EFFECT`, `INVALID` or `APPROXIMATE`. It names an
element and a line. It also names the attribute or property that is the cause, unless the cause is
the element itself.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

from .document import SvgError, in_one_line

NOT_DRAWN = "not drawn"
"""Kind of a notice about an element that is left out, with its children."""

WITHOUT_EFFECT = "without effect"
"""Kind of a notice about an attribute that the reader does not support.

The element is drawn as if the attribute were missing.
"""

INVALID = "ignored as invalid"
"""Kind of a notice about an error in an attribute or element.

The error is handled as the standard prescribes.
"""

APPROXIMATE = "drawn approximately"
"""Kind of a notice about an element that is drawn only approximately."""

_UNSUPPORTED_VALUES = re.compile(
    r"""\b(?:var|env|calc|min|max|clamp|color-mix|translatez|translate3d|scalez|scale3d|rotatex
    |rotatey|rotatez|rotate3d|matrix3d|perspective)\s*\(|\bcontext-(?:fill|stroke)\b""",
    re.IGNORECASE | re.VERBOSE,
)
"""Matches values of CSS and SVG that are valid, but that this reader does not support."""

MAX_NAMES = 50
"""Maximum number of causes of each kind that a warning names, which bounds its length."""


def kind_of_refused(value: str) -> str:
    """The kind of notice about an attribute's or property's value that the reader cannot parse.

    It is `WITHOUT_EFFECT` if the value has a function or keyword that is valid but not supported,
    such as `calc(` or `context-fill`, and `INVALID` for any other value.
    """
    return WITHOUT_EFFECT if _UNSUPPORTED_VALUES.search(value) else INVALID


class _Cause(NamedTuple):
    """The kind, element and attribute of a notice. Notices of the same cause are counted together.

    `element` is the tag of the element, so that elements of one name share a cause. `attribute` is
    None if the element itself is the cause.
    """

    kind: str
    element: str
    attribute: str | None


class Notices:
    """Counts the notices about a document by cause: kind of notice, name of element, attribute.

    For each cause, it stores the line and the detail of the first notice.

    - `name`: name of the document, for messages.
    - `strict`: whether `add` raises an error instead of counting.
    """

    def __init__(self, name: str, strict: bool):
        self._name = name
        self._strict = strict
        self._counts: dict[_Cause, int] = {}
        self._first: dict[_Cause, str] = {}

    def add(
        self, kind: str, element: str, line: int, attribute: str | None = None, detail: str = ""
    ) -> None:
        """Count a notice.

        - `kind`: `NOT_DRAWN`, `WITHOUT_EFFECT`, `INVALID` or `APPROXIMATE`.
        - `element`, `line`: tag and line number of the element.
        - `attribute`: the attribute or property that is the cause; None if the cause is the
          element.
        - `detail`: the value of the attribute, or what is wrong with it; may be empty.

        Raises `SvgError` instead if the notices are `strict`.
        """
        detail = detail.removeprefix(f"{attribute}: ").rstrip(".")
        cause = _Cause(kind, element[:60], attribute and attribute[:60])
        if self._strict:
            problem = f"{attribute}: {detail or kind}" if attribute else detail or kind
            raise SvgError(f"{self._name}:{line}: <{cause.element}> {problem.rstrip('.')[:300]}.")
        if cause not in self._counts:
            self._first[cause] = f"line {line}" + (f": {detail[:100]}" if detail else "")
        self._counts[cause] = self._counts.get(cause, 0) + 1

    def warning(self) -> str | None:
        """One line that names the causes of all notices, with their counts; None without notices.

        It also gives the line and the detail of the first notice of each cause. At most `MAX_NAMES`
        causes of each kind are named; the others are counted.
        """
        if not self._counts:
            return None
        return in_one_line(f"{self._name}: {'; '.join(self._texts_by_kind())}.")

    def _texts_by_kind(self) -> Iterator[str]:
        """Yield one text for each kind of notice that has been added, which names its causes.

        The order is not drawn, without effect, approximate, invalid.
        """
        for kind in (NOT_DRAWN, WITHOUT_EFFECT, APPROXIMATE, INVALID):
            causes = [cause for cause in self._counts if cause.kind == kind]
            names = [self._named(cause) for cause in causes[:MAX_NAMES]]
            if len(causes) > MAX_NAMES:
                names.append(f"{len(causes) - MAX_NAMES} more")
            if names:
                yield f"{kind}: {', '.join(names)}"

    def _named(self, cause: _Cause) -> str:
        """Describe a cause: its attribute and element, the count, and the line of the first."""
        count, first = self._counts[cause], self._first[cause]
        name = f"<{cause.element}>"
        if cause.attribute:
            name = f"{cause.attribute} of {name}"
        times = f"{count} times, first in " if count > 1 else ""
        return f"{name} ({times}{first})"
