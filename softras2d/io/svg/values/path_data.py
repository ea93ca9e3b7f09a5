"""Makes paths from path data (attribute `d`) and from the basic shapes.

fontTools parses path data. Its regular expressions take quadratic time for long runs of digits in
arcs, and skip text that is no number. The text is therefore first checked by the expressions below,
and rewritten with one blank between words.
"""

import re

from fontTools.svgLib.path import parse_path

from ...shapes.paths import Arc, Path, Subpath, arc_between, end_of
from .numbers import NUMBER

# Possessive, so that matching takes linear time.
_SEPARATOR = r"[ \t\r\n\f]*+,?+[ \t\r\n\f]*+"
_COMMAND = re.compile(r"[ \t\r\n\f]*+([MmZzLlHhVvCcSsQqTtAa])[ \t\r\n\f]*+")
_ARGUMENT = re.compile(rf"({NUMBER}){_SEPARATOR}")
_RUN = re.compile(rf"(?:{NUMBER}{_SEPARATOR})*+")
_FLAG = re.compile(rf"([01]){_SEPARATOR}")

_SAME_POINT = 1e-9
"""Difference of coordinates below which two points count as one point.

It is a fraction of the largest absolute coordinate of the subpath.
"""

_ARGUMENTS = {"M": 2, "L": 2, "T": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "A": 7, "Z": 0}
"""Number of arguments of each command of path data."""


def parse_path_data(text: str) -> tuple[Path, str | None]:
    """Parse path data up to the first error.

    Returns the path before the error, in user units, and the message of the error, or None if there
    is no error. Empty text and `none` give an empty path.

    **Source:** SVG 2, section 9.3.9 (grammar) and 9.5.4 (error handling).
    """
    tidy, error = _checked(text)
    pen = PathPen()
    try:
        parse_path(tidy, pen)
    except (ValueError, IndexError, OverflowError):
        # The message quotes the whole path.
        error = error or "path data must begin with M and have all numbers of each command"
    return pen.path, error


def _checked(text: str) -> tuple[str, str | None]:
    """Check path data against SVG's grammar.

    Returns the longest valid beginning of the text, rewritten so that fontTools can read it, and
    the message of the error that follows; None if there is no error.
    """
    if text.strip() == "none":
        return "", None
    words: list[str] = []
    position = 0
    match = _COMMAND.match(text)
    while match:
        command = match[1]
        count = _ARGUMENTS[command.upper()]
        read = _arc_arguments if command in "Aa" else _arguments
        arguments, position = read(text, match.end()) if count else ([], match.end())
        complete = len(arguments) // count * count if count else 0
        if complete or not count:
            words += [command, *arguments[:complete]]
        if count and (not complete or complete < len(arguments)):
            return _joined(words), f"{command} needs {count} numbers, at {text[position:][:20]!r}"
        match = _COMMAND.match(text, position)
    if text[position:].strip():
        return _joined(words), f"expected a command or a number, at {text[position:][:20]!r}"
    return _joined(words), None


def _arguments(text: str, position: int) -> tuple[list[str], int]:
    """The numbers in a text from `position` on, each as text, and the position after the last."""
    run = _RUN.match(text, position)
    assert run is not None, "a run may be empty"
    return _ARGUMENT.findall(run[0]), run.end()


def _arc_arguments(text: str, position: int) -> tuple[list[str], int]:
    """The arguments of a command `A` in a text from `position` on, and the position after the last.

    Each argument is returned as text. The fourth and fifth of every seven are flags, 0 or 1, which
    need no separator after them.
    """
    arguments: list[str] = []
    while True:
        pattern = _FLAG if len(arguments) % 7 in (3, 4) else _ARGUMENT
        match = pattern.match(text, position)
        if match is None:
            return arguments, position
        arguments.append(match[1])
        position = match.end()


def _joined(words: list[str]) -> str:
    """Join commands and numbers with blanks, in spellings that fontTools reads."""
    # fontTools misreads other spellings, such as `1.` and `007`, and is slow for long numbers.
    # Python reads and rewrites all of these.
    is_plain = _PLAIN_WORD.match
    return " ".join(
        word if len(word) < 40 and is_plain(word) else repr(float(word)) for word in words
    )


_PLAIN_WORD = re.compile(r"(?:-?+(?:0|[1-9][0-9]*+)(?:\.[0-9]++)?+|[A-Za-z])\Z")
"""A command, or a number in a spelling that fontTools can read."""


class PathPen:
    """A pen of fontTools that builds the `Path` in its attribute `path`.

    It receives segments in absolute coordinates. `moveTo` must come before any segment.
    """

    def __init__(self):
        self.path = Path()

    def moveTo(self, point: tuple[float, float]) -> None:
        """Begin a subpath at `point`."""
        self.path.subpaths.append(Subpath(self.path.add_point(*point)))

    def lineTo(self, point: tuple[float, float]) -> None:
        """Add a line from the current point to `point`."""
        self._add(point)

    def qCurveTo(self, control: tuple[float, float], end: tuple[float, float]) -> None:
        """Add a quadratic Bezier curve from the current point to `end`."""
        self._add(control, end)

    def curveTo(
        self, first: tuple[float, float], second: tuple[float, float], end: tuple[float, float]
    ) -> None:
        """Add a cubic Bezier curve from the current point to `end`.

        `first` and `second` are its control points.
        """
        self._add(first, second, end)

    def arcTo(
        self,
        rx: float,
        ry: float,
        rotation: float,
        large: bool,
        sweep: bool,
        end: tuple[float, float],
    ) -> None:
        """Add an elliptical arc from the current point to `end`.

        - `rx`, `ry`: lengths of the half axes, whose signs do not count.
        - `rotation`: angle from the x axis to the axis of `rx`, in degrees, positive towards y.
        - `large`, `sweep`: the flags of the path command `A`.

        Radii that are too short to reach both ends are enlarged. An arc becomes a line if a radius
        is zero, if its ends are equal, or if its center cannot be computed.
        """
        subpath = self.path.subpaths[-1]
        start = self.path.points[_last(subpath)]
        ellipse = arc_between(start, end, (rx, ry), rotation, large, sweep)
        if ellipse is None:
            self._add(end)
        else:
            subpath.segments.append(Arc(self.path.add_point(*end), *ellipse))

    def closePath(self) -> None:
        """Close the subpath; `moveTo` must begin the next one.

        If the subpath ends away from its start, a straight line between them is implied
        (`Subpath.closed`). If the last segment ends at the subpath's start, up to rounding, both
        points become one control point: the last point is deleted from `path.points`.
        """
        subpath = self.path.subpaths[-1]
        subpath.closed = True
        last = _last(subpath)
        segment = subpath.segments[-1] if subpath.segments else None
        if last == subpath.start or not self._is_at_start(subpath, last):
            return
        # If the last segment ends where the subpath begins, both share one control point.
        if isinstance(segment, Arc):
            subpath.segments[-1] = segment._replace(end=subpath.start)
        elif segment is not None:
            subpath.segments[-1] = (*segment[:-1], subpath.start)
        # The segment's former end is the last point, so no other segment refers to it.
        del self.path.points[last:]

    def _is_at_start(self, subpath: Subpath, index: int) -> bool:
        """Whether the point with an index in `Path.points` equals the start of a subpath.

        They count as equal if both coordinates differ by less than `_SAME_POINT` times the largest
        absolute coordinate of the subpath, since relative commands accumulate rounding errors.
        """
        (x, y), (start_x, start_y) = self.path.points[index], self.path.points[subpath.start]
        if (x, y) == (start_x, start_y):
            return True
        largest = max(max(abs(x), abs(y)) for x, y in self.path.points[subpath.start :])
        return max(abs(x - start_x), abs(y - start_y)) < _SAME_POINT * largest

    def endPath(self) -> None:
        """Leave the subpath open, which needs no action."""

    def _add(self, *points: tuple[float, float]) -> None:
        """Add a line or Bezier curve from the current point, with these further control points.

        The last of `points` is its end.
        """
        indices = tuple(self.path.add_point(*point) for point in points)
        self.path.subpaths[-1].segments.append(indices)


def _last(subpath: Subpath) -> int:
    """Index in `Path.points` of the current point of a subpath: the end of its last segment."""
    if not subpath.segments:
        return subpath.start
    return end_of(subpath.segments[-1])


def polygon_path(points: list[tuple[float, float]], closed: bool) -> Path:
    """The path of straight lines through `points`, which has no subpath if there are no points.

    `closed` says whether one more line joins the last point to the first.
    """
    path = Path(points=list(points))
    if points:
        path.subpaths.append(Subpath(0, [(k,) for k in range(1, len(points))], closed))
    return path


def rect_path(x: float, y: float, width: float, height: float, rx: float, ry: float) -> Path:
    """The path of a rectangle, clockwise on the screen, where the top side comes first.

    - `x`, `y`: the top left corner.
    - `rx`, `ry`: radii of rounded corners, at most half of the sides. Corners are sharp if either
      is 0 or less. All points of a rect with rounded corners are in `Path.fixed`.

    **Source:** SVG 2, section 10.2.
    """
    if rx <= 0 or ry <= 0:
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        return polygon_path(corners, True)
    right, bottom = x + width, y + height
    pen = PathPen()
    pen.moveTo((x + rx, y))
    for line_end, arc_end in (
        ((right - rx, y), (right, y + ry)),
        ((right, bottom - ry), (right - rx, bottom)),
        ((x + rx, bottom), (x, bottom - ry)),
        ((x, y + ry), (x + rx, y)),
    ):
        pen.lineTo(line_end)
        pen.arcTo(rx, ry, 0.0, False, True, arc_end)
    pen.closePath()
    return _fixed(pen.path)


def ellipse_path(cx: float, cy: float, rx: float, ry: float) -> Path:
    """The path of an ellipse around `(cx, cy)` with radii `rx` and `ry`.

    It runs clockwise on the screen from the rightmost point.

    **Source:** SVG 2, sections 10.3 and 10.4.
    """
    pen = PathPen()
    ends = [(cx, cy + ry), (cx - rx, cy), (cx, cy - ry), (cx + rx, cy)]
    pen.moveTo(ends[-1])
    for end in ends:
        pen.arcTo(rx, ry, 0.0, False, True, end)
    pen.closePath()
    return _fixed(pen.path)


def _fixed(path: Path) -> Path:
    """Mark all points of a path as fixed, since no attribute of the file lists them.

    Returns the path.
    """
    path.fixed = set(range(len(path.points)))
    return path
