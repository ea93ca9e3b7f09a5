"""Reads the scene that the command line names: a file, `-` (standard input), or a bundled scene.

A file takes precedence over a bundled scene of the same name. This module imports JAX, so it is
imported only while a command runs.
"""

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from .. import scenes
from ..io.svg.reading.declared_size import size_with_margins
from ..io.svg.reading.reader import parse_svg, parse_svg_size, read_svg, svg_size
from ..io.svg.xml.document import MAX_BYTES, from_text, load
from ..scene import Scene


@dataclass(frozen=True)
class SceneSource:
    """The scene that an argument of a command names.

    - `path`: a file, `-` for standard input, or the name of a bundled scene.
    - `dialect`: dialect of SVG in which a file or standard input is read.
    """

    path: Path
    dialect: str

    @cached_property
    def _standard_input(self) -> bytes | None:
        """The bytes of standard input, which can be read only once; None for other sources.

        At most `MAX_BYTES` + 1 bytes are read, because longer documents are refused.
        """
        if str(self.path) != "-":
            return None
        return sys.stdin.buffer.read(MAX_BYTES + 1)

    def size(self) -> tuple[int, int]:
        """The (height, width) in pixels that the scene declares.

        Raises `ValueError` for a file that cannot be read, and for one that declares no size; the
        message then names the option `--size`.
        """
        if scenes.is_bundled(self.path):
            return scenes.SIZE, scenes.SIZE
        try:
            if self._standard_input is not None:
                return parse_svg_size(self._standard_input, name="-", dialect=self.dialect)
            return svg_size(self.path, dialect=self.dialect)
        except ValueError as error:
            # On the command line, an option sets the size.
            message = str(error).replace("pass `height` and `width`", "use --size WIDTHxHEIGHT")
            raise ValueError(message) from None

    def size_with_margins(self, height: int, width: int) -> tuple[float, float] | None:
        """The (height, width) of the drawing if margins would remain on a canvas, otherwise None.

        The canvas has `height` x `width` pixels. The result is in the drawing's own units, such as
        those of its `viewBox`. Raises `ValueError` for a file that cannot be read or declares
        neither a `viewBox` nor a size.
        """
        if scenes.is_bundled(self.path):
            side = scenes.SIZE
            return None if abs(height - width) <= 1 else (side, side)
        text = self._standard_input
        document = load(self.path) if text is None else from_text(text, "-")
        return size_with_margins(document, height, width)

    def read(self, **keywords: Any) -> Scene:
        """Read the scene.

        `keywords`: the keyword arguments of `read_svg` other than `dialect`, among them `height`
        and `width`. For a bundled scene that a Python function makes, only these two are used. A
        bundled scene that is an SVG file is read in the dialect in which it is written.
        """
        if scenes.is_bundled(self.path):
            name = str(self.path)
            if scenes.is_scripted(name):
                keywords = {key: keywords[key] for key in ("height", "width")}
            return scenes.read(name, **keywords)
        if self._standard_input is not None:
            return parse_svg(self._standard_input, name="-", dialect=self.dialect, **keywords)
        return read_svg(self.path, dialect=self.dialect, **keywords)
