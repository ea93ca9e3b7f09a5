"""SVG files to scenes, in two dialects: SVG as it is defined, and the course's subset of it."""

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...geometry.affine_maps import check_map
from ...scene import Scene
from ...texture.pyramid import TexturePyramid
from ..budget import Budget
from .assets import Assets
from .context import Context
from .course_dialect import CourseDialect
from .display_list import DisplayList, Triangles
from .document import UNFORESEEN, Document, SvgError, from_text, load, reason, root, walk
from .elements import Dialect, ElementReader
from .svg_dialect import StandardDialect
from .view_box import MAX_SIDE, document_size, round_up

_DIALECTS: dict[str, Callable[[Context], Dialect[Any]]] = {
    "svg": StandardDialect,
    "course": CourseDialect,
}


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
) -> Scene:
    """The scene of an SVG file, with the smallest structure that holds it, over white.

    - `height`, `width`: the canvas in pixels; the file's own size, rounded up, unless given. The
      drawing is fitted into it: by viewBox and preserveAspectRatio, or by the course's rule.
    - `dialect`: `"svg"`, standard meaning, or `"course"`, the classic rasterizer course's, with
      unantialiased lines. Both know `colortri`, `textri` and `texture`.
    - `transform`: a homogeneous 3x3 map from the file's units to pixels, instead of that fit.
    - `assets`: the folder in which files that the scene names must lie; by default the scene's own.
    - `opacity=False` ignores every opacity and alpha.
    - `frame`: whether the course's outline of the canvas is drawn; it is, by default, there.
    - `linear=True` decodes colours and textures from sRGB to linear light.

    In `svg` a first opaque rect over viewBox and canvas becomes the `background`. Group opacity is
    multiplied into the children. Vertices are mapped in float64 and rounded to float32. Elements
    and properties that are not drawn are named, with counts, in one `UserWarning`.

    Raises `ValueError`, one line with file and line number, for a document that is not well-formed,
    declares entities or is larger than 64 MB, for numbers that are none, for pictures that are
    missing or outside `assets`, and for a `transform` that is singular or sends points to infinity.
    Also for a document that asks for more work than the limits in `softras2d.io.budget` allow,
    which are counted before the work is done: 2,097,152 triangles, 4,194,304 points, 100,000 points
    in which polygons cross themselves, 67,108,864 pixels in all pictures together (1 GiB), and
    others.
    """
    return _scene(
        load(path), height, width, dialect, transform, assets, opacity, frame, linear, stacklevel=3
    )


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
) -> Scene:
    """As `read_svg`, from the text of a file, which errors call `name`.

    Files that the text names start from `assets`; without it there are none.
    """
    document = from_text(text, name)
    return _scene(
        document, height, width, dialect, transform, assets, opacity, frame, linear, stacklevel=3
    )


def svg_size(path: str | os.PathLike[str], *, dialect: str = "svg") -> tuple[int, int]:
    """The file's own (height, width) in pixels, rounded up; in `svg` from the viewBox if need be.

    Raises `ValueError`, one line, if the file has no size.
    """
    _check_dialect(dialect)
    return _document_size(load(path), dialect)


def _document_size(document: Document, dialect: str) -> tuple[int, int]:
    tag, attributes = root(document)
    try:
        size = document_size(attributes, dialect)
        if size is None:
            known = "width and height" if dialect == "course" else "width, height or viewBox"
            raise ValueError(f"has no size of its own ({known}): give `height` and `width`.")
    except (ValueError, *UNFORESEEN) as error:
        raise SvgError(f"{document.name}: <{tag[:60]}> {reason(error)}") from None
    return round_up(size)


def _scene(
    document: Document,
    height: int | None,
    width: int | None,
    dialect: str,
    transform: Any,
    assets: str | os.PathLike[str] | None,
    opacity: bool,
    frame: bool | None,
    linear: bool,
    stacklevel: int,
) -> Scene:
    _check_dialect(dialect)
    if frame and dialect != "course":
        raise ValueError("`frame=True` belongs to dialect 'course'.")
    height, width = _canvas(document, dialect, height, width)
    budget = Budget()
    context = Context(
        name=document.name,
        height=height,
        width=width,
        transform=None if transform is None else check_map(transform),
        opacity=opacity,
        frame=dialect == "course" if frame is None else frame,
        assets=Assets(
            document.folder,
            None if assets is None else Path(assets),
            alpha=opacity and dialect == "svg",
            budget=budget,
        ),
        display=DisplayList(document.name, budget),
    )
    # Overflow shows as a coordinate that is not finite, which is an error of its own.
    with np.errstate(over="ignore", invalid="ignore"):
        walk(document, ElementReader(_DIALECTS[dialect](context), context), budget)
        with _named(document):
            triangles = context.display.finish(height, width)
    if message := context.warning():
        warnings.warn(message, UserWarning, stacklevel=stacklevel)
    addressing = "corners" if dialect == "course" else "half_texel"
    with _named(document), np.errstate(over="ignore", invalid="ignore"):
        return _assembled(context, triangles, addressing, linear)


@contextmanager
def _named(document: Document) -> Iterator[None]:
    """Name the document in errors that do not: of checks, and of libraries beneath."""
    try:
        yield
    except SvgError:
        raise
    except (ValueError, *UNFORESEEN) as error:
        raise SvgError(f"{document.name}: {reason(error)}") from None


def _canvas(
    document: Document, dialect: str, height: int | None, width: int | None
) -> tuple[int, int]:
    if height is None or width is None:
        own_height, own_width = _document_size(document, dialect)
        height = own_height if height is None else height
        width = own_width if width is None else width
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise ValueError(
            f"{document.name}: a canvas has 1 to {MAX_SIDE} pixels a side; "
            f"`height` is {height} and `width` {width}."
        )
    return int(height), int(width)


def _check_dialect(dialect: str) -> None:
    if dialect not in _DIALECTS:
        raise ValueError(f"`dialect` must be 'svg' or 'course'; got {dialect!r}.")


def _assembled(
    context: Context,
    triangles: Triangles,
    addressing: Literal["corners", "half_texel"],
    linear: bool,
) -> Scene:
    """The scene, without what no triangle of it needs."""
    colors = triangles.colors
    background = np.array(context.background or (1.0, 1.0, 1.0))
    if linear:
        # Imported here: it brings an image library.
        from ..images import srgb_to_linear

        colors = np.concatenate([srgb_to_linear(colors[..., :3]), colors[..., 3:]], axis=-1)
        background = srgb_to_linear(background)
    images = context.assets.textures
    if (colors[..., 3] == 1).all() and all(image.shape[-1] == 3 for image in images):
        colors = colors[..., :3]
    if (colors == colors[:, :1]).all():
        colors = colors[:, :1]
    textured = {}
    if images:
        textured = {
            "uv": triangles.uv,
            "texture_index": triangles.texture.astype(np.int32),
            "textures": TexturePyramid.build(images, "clamp", addressing, linear),
        }
    return Scene.from_soup(
        triangles.corners,
        colors,
        background=background.astype(np.float32),
        **textured,
    )
