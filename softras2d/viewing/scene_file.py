"""Defines the subject that is an SVG drawing, read again for each zoom and whenever it changes.

A subject is a drawing or an image that the viewer shows (`subject.py`).
"""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..io.svg.reading.declared_size import declared_size
from ..io.svg.reading.reader import read_document_with_notice
from ..io.svg.xml.document import Document, SvgError, from_text, load
from ..names import SvgDialect
from ..options import Filter, Hard
from ..scene import Scene
from .settings import Settings
from .subject import SceneCache, Subject
from .view import View, enlarged_size


@dataclass(frozen=True)
class ReadOptions:
    """How SVG files are read; the fields are arguments of `read_svg`.

    - `dialect`: `"svg"`, or `"course"` for the rules of the rasterizer course.
    - `assets`: folder outside of which no image is read; None for the folder of the file.
    - `frame`: whether the course's black frame is drawn; None for the default of the dialect.
    - `opacity`: whether opacity and alpha are applied; if not, everything is opaque.
    """

    dialect: SvgDialect = "svg"
    assets: Path | None = None
    frame: bool | None = None
    opacity: bool = True

    def arguments(self) -> dict[str, Any]:
        """The options as keyword arguments of `read_document_with_notice`."""
        return {
            "dialect": self.dialect,
            "assets": self.assets,
            "frame": self.frame,
            "opacity": self.opacity,
        }

    def flags(self) -> list[str]:
        """The options as words of a command line of `softras2d render`, without default values."""
        flags = [] if self.dialect == "svg" else ["--dialect", self.dialect]
        flags += [] if self.assets is None else ["--assets", str(self.assets)]
        flags += [] if self.frame is None else ["--frame" if self.frame else "--no-frame"]
        return flags + ([] if self.opacity else ["--no-opacity"])


class SceneFile(Subject):
    """A subject that is an SVG file, or the text of one.

    The drawing is read again at each zoom, so that curves are as smooth, and lines of one pixel as
    thin, as the enlarged drawing needs.

    - `path`: the file, or the name that stands for `text` on the command line, such as `-`. Its
      last part is the name of the subject.
    - `options`: how the drawing is read.
    - `text`: contents to read instead of the file, such as standard input; None to read the file.
    """

    def __init__(self, path: Path, options: ReadOptions, text: bytes | None = None):
        super().__init__(path.name)
        self.may_change = text is None
        self._path = path
        self._text = text
        self._options = options
        self._scenes = SceneCache()
        self._size: tuple[int, tuple[int, int]] | None = None
        self._notes: tuple[str, ...] = ()

    @property
    def version(self) -> int:
        """Time of the last change of the file, in nanoseconds; 0 for a text or a missing file."""
        if self._text is not None:
            return 0
        try:
            return self._path.stat().st_mtime_ns
        except OSError:
            return 0

    def size(self) -> tuple[int, int]:
        """Height and width, in pixels, that the drawing declares.

        Raises `SvgError` if the drawing cannot be read or declares no size.
        """
        version = self.version
        if self._size is None or self._size[0] != version:
            try:
                size = declared_size(self._document(), self._options.dialect)
            except SvgError as error:
                # The viewer has no option for the size.
                message = str(error).replace("pass `height` and `width`", "give it one")
                raise SvgError(message) from None
            self._size = version, size
        return self._size[1]

    def _document(self) -> Document:
        """The document, from the file or from the text."""
        if self._text is None:
            return load(self._path)
        return from_text(self._text, str(self._path))

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene of the drawing, read at its declared size times `zoom`, in whole pixels.

        Raises `ValueError` if the drawing cannot be read, or if the enlarged drawing has too many
        pixels a side.
        """
        return self._scenes.get(self, zoom, self._read)

    def _read(self, height: int, width: int) -> Scene:
        """Read the drawing for a canvas of `height` x `width` pixels, and store its warnings."""
        scene, notice = read_document_with_notice(
            self._document(), height=height, width=width, **self._options.arguments()
        )
        self._notes = () if notice is None else (notice,)
        return scene

    def notes(self) -> tuple[str, ...]:
        """Warnings about what was left out or ignored when the drawing was last read."""
        return self._notes

    def command(self, view: View, settings: Settings) -> str:
        """The command line of `softras2d render` that draws the same picture, quoted for a shell.

        It writes the picture to NAME-view.png in the current folder, if the file is NAME.svg.
        """
        height, width = enlarged_size(*self.size(), view.zoom)
        name = "stdin" if str(self._path) == "-" else self._path.stem
        words = ["softras2d", "render", str(self._path), "-o", f"{name}-view.png"]
        words += ["--size", f"{width}x{height}", "--origin", f"{view.x},{view.y}"]
        words += ["--window", f"{view.width}x{view.height}"]
        words += self._options.flags() + settings_flags(settings)
        return shlex.join(words)


def settings_flags(settings: Settings) -> list[str]:
    """The settings as words of a command line of `softras2d render`.

    The words always say the number of samples, or the kind of coverage if it is not sampled, with
    the width of soft edges. Other settings are left out if they have their default values.
    """
    flags = []
    if settings.coverage == "sampled":
        hard = Hard()
        flags += ["--samples", str(settings.samples)]
        for name in ("fill_rule", "shading"):
            value = getattr(settings, name)
            flags += [] if value == getattr(hard, name) else [_flag(name), value]
    else:
        flags += ["--coverage", settings.coverage]
        flags += ["--soft-width", f"{settings.soft_width:g}"] * (settings.coverage == "soft")
    default = Filter()
    for name, option in (
        ("pixel_filter", default.pixel),
        ("level_filter", default.level),
        ("anisotropy", default.anisotropy),
        ("lod_bias", default.lod_bias),
    ):
        value = getattr(settings, name)
        text = f"{value:g}" if isinstance(value, float) else str(value)
        flags += [] if value == option else [_flag(name), text]
    return flags


def _flag(name: str) -> str:
    """The flag of `softras2d render` for a field of `Settings`, such as `--lod-bias`."""
    return f"--{name.replace('_', '-')}"
