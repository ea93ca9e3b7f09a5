"""Stores the line number and the colour of each shape, which errors and triangles need."""

import numpy as np

from ..values.css_color import Rgba
from ..xml.document import SvgError


class ShapeTable:
    """The line numbers and colours of the shapes of a drawing, in draw order.

    - `name`: name of the document, for errors.
    """

    def __init__(self, name: str):
        self._name = name
        self._lines: list[int] = []
        self._colors: list[Rgba | np.ndarray] = []

    def __len__(self) -> int:
        """Number of shapes that have been added."""
        return len(self._lines)

    def add(self, line: int, color: Rgba | np.ndarray) -> int:
        """Add a shape; returns its index in draw order.

        - `line`: line number of its element.
        - `color`: one colour, sRGB with straight alpha, or the colours `[3, 4]` of the corners of
          its triangles.
        """
        self._lines.append(line)
        self._colors.append(color)
        return len(self._lines) - 1

    def add_all(self, line: int, colors: np.ndarray) -> None:
        """Add one shape for each of the colours `[k, 4]`, all from the element at one line."""
        self._lines += [line] * len(colors)
        self._colors += map(tuple, colors.tolist())

    def color_table(self) -> np.ndarray:
        """Colours of all shapes in draw order, `[shapes, 1 or 3, 4]`, float32.

        If any shape has one colour per corner, the table has three for every shape. Raises
        `SvgError` for a colour that is not finite in float32.
        """
        if not any(isinstance(color, np.ndarray) for color in self._colors):
            table = np.array(self._colors, np.float64).reshape(-1, 1, 4)
            return self.float32(table, np.arange(len(table)), "a colour")
        colors = [np.reshape(color, (-1, 4)) for color in self._colors]
        if any(len(color) > 1 for color in colors):
            colors = [np.broadcast_to(color, (3, 4)) for color in colors]
        if not colors:
            return np.ones((0, 1, 4), np.float32)
        table = np.array(colors).reshape(len(colors), -1, 4)
        return self.float32(table, np.arange(len(table)), "a colour")

    def is_translucent(self, draws: np.ndarray) -> np.ndarray:
        """Whether the alpha of each of these shapes is below 1.

        `draws` are indices in draw order of shapes that have a single colour each.
        """
        return np.array([self._colors[draw][3] < 1 for draw in draws.tolist()], bool)

    def float32(
        self, values: np.ndarray, draws: np.ndarray, noun: str = "a coordinate"
    ) -> np.ndarray:
        """Round values `[k, ...]` to float32.

        - `draws`: for row i of `values`, the index in draw order of the shape to which it belongs.
        - `noun`: what errors call a value.

        Raises `SvgError` if a rounded value is not finite. The error names the line of the shape to
        which the first row with such a value belongs.
        """
        with np.errstate(over="ignore"):
            rounded = values.astype(np.float32)
        is_bad = ~np.isfinite(rounded).all(axis=tuple(range(1, rounded.ndim)))
        if is_bad.any():
            raise self.error(int(draws[np.argmax(is_bad)]), f"{noun} is not finite in float32.")
        return rounded

    def error(self, draw: int, message: str) -> SvgError:
        """Make an error about the shape with the index `draw`, which names the shape's line."""
        return SvgError(f"{self._name}:{self._lines[draw]}: {message}")
