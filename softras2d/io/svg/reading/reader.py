"""Reads SVG files as scenes, in two dialects: standard SVG, and the rasterizer course's subset."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from ....geometry.affine_maps import check_map
from ....names import SvgDialect
from ....numerics.arguments import checked_integer
from ....scene import Scene
from ...budget import Budget
from ...shapes.paths import TOLERANCE
from ..canvas.display_list import DisplayList
from ..canvas.triangles import Triangles
from ..elements.context import Context
from ..elements.page import Page
from ..elements.view_box import MAX_SIDE
from ..xml.assets import Assets
from ..xml.document import LIBRARY_ERRORS, Document, SvgError, from_text, load, reason, walk
from ..xml.notices import WITHOUT_EFFECT, Notices
from ..xml.tree import Element, read_tree
from .control_points import SvgControls, make_controls
from .course_dialect import CourseReader
from .declared_size import declared_size
from .scene_of_triangles import make_scene
from .svg_dialect import Drawing

_DIALECTS = get_args(SvgDialect)

_PRESERVE_ASPECT_RATIO = {
    # Values of `fit`, and what they mean as `preserveAspectRatio`.
    "contain": "xMidYMid meet",
    "cover": "xMidYMid slice",
    "stretch": "none",
}


@dataclass(frozen=True)
class _Options:
    """The arguments of `read_svg` other than `path`, `height` and `width`."""

    dialect: str
    transform: Any
    assets: str | os.PathLike[str] | None
    opacity: bool
    frame: bool | None
    linear: bool
    tolerance: float
    strict: bool
    fit: str | None


def read_svg(
    path: str | os.PathLike[str],
    *,
    height: int | None = None,
    width: int | None = None,
    dialect: str = "svg",
    transform: Any = None,
    assets: str | os.PathLike[str] | None = None,
    opacity: bool = True,
    frame: bool | None = None,
    linear: bool = False,
    tolerance: float = TOLERANCE,
    strict: bool = False,
    fit: str | None = None,
) -> Scene:
    """Read an SVG file as a scene.

    The scene has no textures, no alpha channel and no corner colours unless the drawing needs them.
    Its background is white unless the file has another one. No vertices are shared by triangles.

    - `height`, `width`: size of the canvas in pixels; each is by default the side that the file
      declares, rounded up. The drawing is fitted into the canvas by its viewBox and
      preserveAspectRatio, or by the course's rule.
    - `dialect`: `"svg"`, standard SVG; or `"course"`, the classic rasterizer course's rules, with
      lines one pixel wide that are not antialiased. Both have the additional elements `colortri`,
      `textri` and `texture`.
    - `transform`: homogeneous 3x3 map of columns (x, y, 1) from user units of the root to pixels.
      It replaces the map that fits the drawing into the canvas.
    - `assets`: folder outside of which no image file is read; by default the folder of the file.
    - `opacity`: whether opacities and alpha are applied; if not, everything is opaque.
    - `frame`: whether the course's black outline of the drawing is drawn. By default it is drawn in
      dialect `"course"`; in dialect `"svg"`, `True` is an error.
    - `linear`: whether colours and textures are decoded from sRGB to linear light.
    - `tolerance`: largest distance between a curve and its polygon, in pixels of the canvas, 0.0001
      to 10000.
    - `strict`: whether anything invalid or not supported is an error instead of a warning.
    - `fit`: how a drawing of another aspect ratio fills the canvas: `"contain"` leaves margins,
      `"cover"` cuts the drawing, `"stretch"` distorts it. By default, the file's
      preserveAspectRatio decides. Only for dialect `"svg"`, and not together with `transform`.

    Dialect `"svg"` draws paths, basic shapes, images, style sheets, gradients, clip paths, dashes,
    `use`, `symbol`, nested `svg` and `switch`. The shapes of a group with `opacity` are cut into
    regions that do not overlap, so that the opacity applies to the composited group. Not drawn are
    text, filters, masks, patterns, markers, blend modes, `foreignObject` and animations. An invalid
    attribute is ignored as SVG 2 says. A single `UserWarning` lists all that is left out or
    ignored: element, attribute, first line, and count.

    In dialect `"svg"`, the `background` of the scene is an opaque `background-color` of the root,
    or else the fill of the first shape if that is an opaque rect that covers viewBox and canvas.
    Vertices are mapped to pixels in float64 and rounded to float32.

    Media queries are evaluated for a screen of the canvas's size with the light colour scheme. An
    image that is missing, unreadable or outside `assets` is left out in dialect `"svg"`, and an
    error in dialect `"course"`.

    Raises `ValueError`, one line, with file and line number if an element is the cause, for:

    - arguments that are out of range or exclude each other, and a file that cannot be read, or that
      declares no size if `height` or `width` is None;
    - a document that is not well-formed, declares entities other than short texts, or is larger
      than 64 MB;
    - textures that are missing or outside `assets`;
    - invalid attributes of `colortri` and `textri`, numbers that the course's dialect cannot read,
      and coordinates that are not finite in float32;
    - a `transform` that is singular or sends points to infinity;
    - a document that exceeds a limit of `softras2d.io.budget`, such as 2,097,152 triangles,
      4,194,304 points, or 67,108,864 pixels in all images together (1 GiB).
    """
    options = _Options(dialect, transform, assets, opacity, frame, linear, tolerance, strict, fit)
    result = _read(load(path), height, width, options)
    _warn(result)
    return result.scene


def read_document_with_notice(
    document: Document, *, height: int, width: int, dialect: str = "svg",
    assets: str | os.PathLike[str] | None = None, opacity: bool = True, frame: bool | None = None,
) -> tuple[Scene, str | None]:  # fmt: skip
    """Read a document like `read_svg`, but return the warning instead of issuing it.

    Returns the scene, and the text of the warning; None for no warning. The other arguments are as
    in `read_svg`. Threads share the filters of the module `warnings`, so a thread could not safely
    catch a warning that it has issued.
    """
    options = _Options(dialect, None, assets, opacity, frame, False, TOLERANCE, False, None)
    result = _read(document, height, width, options)
    return result.scene, result.notice


def parse_svg(
    text: str | bytes,
    *,
    name: str = "<svg>",
    height: int | None = None,
    width: int | None = None,
    dialect: str = "svg",
    transform: Any = None,
    assets: str | os.PathLike[str] | None = None,
    opacity: bool = True,
    frame: bool | None = None,
    linear: bool = False,
    tolerance: float = TOLERANCE,
    strict: bool = False,
    fit: str | None = None,
) -> Scene:
    """Read the text of an SVG file as a scene, like `read_svg`.

    - `name`: what errors and warnings call the document.
    - `assets`: folder to which names of image files are relative, and outside of which none is
      read. Without it, only images in `data:` URIs are read.

    The other arguments are as in `read_svg`.
    """
    options = _Options(dialect, transform, assets, opacity, frame, linear, tolerance, strict, fit)
    result = _read(from_text(text, name), height, width, options)
    _warn(result)
    return result.scene


def read_svg_controls(
    path: str | os.PathLike[str],
    *,
    height: int | None = None,
    width: int | None = None,
    transform: Any = None,
    assets: str | os.PathLike[str] | None = None,
    opacity: bool = True,
    linear: bool = False,
    tolerance: float = TOLERANCE,
    strict: bool = False,
    fit: str | None = None,
) -> SvgControls:
    """Read an SVG file as a scene whose vertices are computed from the control points of its paths.

    The arguments are those of `read_svg` in dialect `"svg"`. Vertices on lines and Bezier curves of
    filled paths, polygons and polylines are affine functions of the control points. All other
    vertices are constant; `SvgControls.constant_vertices` counts them. Raises `ValueError` as
    `read_svg` does, and for a `transform` in perspective.
    """
    document = load(path)
    options = _Options("svg", transform, assets, opacity, None, linear, tolerance, strict, fit)
    result = _read(document, height, width, options, keeps_sources=True)
    _warn(result)
    drawing = result.drawing
    assert drawing is not None
    with _name_document_in_errors(document):
        return make_controls(
            document, drawing.root, result.scene, result.triangles, drawing.canvas,
            drawing.painter.sources,
        )  # fmt: skip


def svg_size(path: str | os.PathLike[str], *, dialect: str = "svg") -> tuple[int, int]:
    """The (height, width) in pixels that an SVG file declares, rounded up.

    `dialect` is as in `read_svg`. In dialect `"svg"`, style sheets outrank the attributes of the
    root, and a missing side is computed from the viewBox. In dialect `"course"`, units are ignored.
    Raises `ValueError`, one line, if the file cannot be read or declares no size.
    """
    _check_dialect(dialect)
    return declared_size(load(path), dialect)


def parse_svg_size(
    text: str | bytes, *, name: str = "<svg>", dialect: str = "svg"
) -> tuple[int, int]:
    """The (height, width) that the text of an SVG file declares, like `svg_size`.

    `name` is what errors call the document.
    """
    _check_dialect(dialect)
    return declared_size(from_text(text, name), dialect)


class _ReadResult(NamedTuple):
    """The result of reading a document.

    - `triangles`: the triangles of which `scene` was made, in the same order, with the index in
      draw order of the shape of each.
    - `drawing`: the object that drew the document; None in dialect `"course"`.
    - `notice`: one line about all that was left out or ignored, for a warning; None for nothing.
    """

    scene: Scene
    triangles: Triangles
    drawing: Drawing | None
    notice: str | None


def _read(
    document: Document,
    height: int | None,
    width: int | None,
    options: _Options,
    keeps_sources: bool = False,
) -> _ReadResult:
    """Read a document as a scene.

    - `height`, `width`: size of the canvas in pixels; None for the side that the document declares.
    - `keeps_sources`: whether the painter stores the paths that it fills, for `make_controls`.

    Raises `ValueError` as `read_svg` does. No warning is issued.
    """
    _check_options(options)
    budget = Budget()
    is_course = options.dialect == "course"
    tree = None if is_course else read_tree(document, budget)
    height, width = _canvas_size(document, options.dialect, tree, height, width)
    context = Context(
        name=document.name,
        height=height,
        width=width,
        transform=None if options.transform is None else check_map(options.transform),
        opacity=options.opacity,
        frame=is_course if options.frame is None else options.frame,
        fit=None if options.fit is None else _PRESERVE_ASPECT_RATIO[options.fit],
        assets=Assets(
            document.folder,
            None if options.assets is None else Path(options.assets),
            alpha=options.opacity and not is_course,
            budget=budget,
        ),
        display=DisplayList(document.name, budget),
    )
    drawing = None
    # An overflow gives a coordinate that is not finite, which the display list reports. GEOS may
    # leave any flag set.
    with np.errstate(all="ignore"):
        if tree is None:
            walk(document, CourseReader(context), budget)
        else:
            notices = Notices(document.name, options.strict)
            with _name_document_in_errors(document):
                _note_style_sheet(document, notices)
                drawing = Drawing(Page(tree, context, notices, options.tolerance))
            drawing.painter.keeps_sources = keeps_sources
            drawing.draw()
        with _name_document_in_errors(document):
            triangles = context.display.finish(height, width)
    notice = context.warning() if is_course else notices.warning()
    if notice and options.strict:
        raise SvgError(notice)
    addressing = "corners" if is_course else "half_texel"
    with _name_document_in_errors(document), np.errstate(over="ignore", invalid="ignore"):
        scene = make_scene(context, triangles, addressing, options.linear)
    return _ReadResult(scene, triangles, drawing, notice)


def _note_style_sheet(document: Document, notices: Notices) -> None:
    """Add a notice if an external style sheet is named before the root, since it is not read.

    Only the first `<?xml-stylesheet ...?>` is noted.
    """
    prolog = document.data.partition(b"<svg")[0]
    preceding, marker, _ = prolog.partition(b"<?xml-stylesheet")
    if marker:
        notices.add(WITHOUT_EFFECT, "?xml-stylesheet?", preceding.count(b"\n") + 1, "href")


def _warn(result: _ReadResult) -> None:
    """Issue the notice of a document, if there is one, as a `UserWarning`.

    The warning points to the code that called the public function.
    """
    if result.notice:
        warnings.warn(result.notice, UserWarning, stacklevel=3)


@contextmanager
def _name_document_in_errors(document: Document) -> Iterator[None]:
    """Turn errors of the body into `SvgError`s that begin with the document's name.

    It is a context manager. It handles `ValueError` and `LIBRARY_ERRORS`; an `SvgError` is passed
    on unchanged, since it has the name already.
    """
    try:
        yield
    except SvgError:
        raise
    except (ValueError, *LIBRARY_ERRORS) as error:
        raise SvgError(f"{document.name}: {reason(error)}") from None


def _canvas_size(
    document: Document,
    dialect: str,
    tree: Element | None,
    height: int | None,
    width: int | None,
) -> tuple[int, int]:
    """The (height, width) of the canvas, in pixels.

    - `height`, `width`: the sides that the caller gave; None for the side that the document
      declares.
    - `tree`: root of the document; None in dialect `"course"`.

    Raises `ValueError` if a declared side is needed and there is none, and unless both sides are
    integers from 1 to `MAX_SIDE`, which is 2^20.
    """
    if height is None or width is None:
        file_height, file_width = declared_size(document, dialect, tree)
        height = file_height if height is None else height
        width = file_width if width is None else width
    with _name_document_in_errors(document):
        height = checked_integer("height", height, 1, MAX_SIDE)
        return height, checked_integer("width", width, 1, MAX_SIDE)


def _check_dialect(dialect: str) -> None:
    """Raise `ValueError` unless `dialect` is `"svg"` or `"course"`."""
    if dialect not in _DIALECTS:
        raise ValueError(f"`dialect` must be 'svg' or 'course'; got {dialect!r}.")


def _check_options(options: _Options) -> None:
    """Raise `ValueError` for options that are out of range, or that exclude each other.

    These are an unknown `dialect` or `fit`; `frame=True` unless the dialect is `"course"`; a
    `tolerance` that is not 0.0001 to 10000 pixels; and `fit` in dialect `"course"` or together with
    `transform`.
    """
    _check_dialect(options.dialect)
    if options.frame and options.dialect != "course":
        raise ValueError(f"`frame=True` needs dialect 'course'; got dialect {options.dialect!r}.")
    is_number = isinstance(options.tolerance, int | float | np.number)
    if not is_number or not 1e-4 <= options.tolerance <= 1e4:
        raise ValueError(f"`tolerance` must be 0.0001 to 10000 pixels; got {options.tolerance!r}.")
    if options.fit is not None and options.dialect == "course":
        raise ValueError("`fit` applies to dialect 'svg' only.")
    if options.fit is not None and options.transform is not None:
        raise ValueError("give `fit` or `transform`, not both.")
    if options.fit is not None and options.fit not in _PRESERVE_ASPECT_RATIO:
        raise ValueError(
            f"`fit` must be {', '.join(map(repr, _PRESERVE_ASPECT_RATIO))}; got {options.fit!r}."
        )
