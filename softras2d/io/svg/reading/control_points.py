"""Maps the control points of a drawing to the vertices of its triangles.

A Bezier curve is flattened at fixed parameters, so that each vertex on a curve or line of a filled
path is a fixed linear combination of at most four control points. The map is affine. It moves the
triangles into which the drawing of the file was divided, and never triangulates again. After large
moves, triangles may therefore overlap or turn over.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple
from xml.parsers import expat

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ....scene import Scene
from ...shapes.paths import Arc, Path
from ..canvas.sinks import Canvas
from ..canvas.triangles import Triangles
from ..elements.page import elements
from ..painting.painter import FillSource
from ..xml.document import Document, SvgError
from ..xml.tree import Element

_ATTRIBUTE = {"path": "d", "polygon": "points", "polyline": "points"}
"""For each element with control points, the attribute that holds them."""


class ControlledPath(NamedTuple):
    """A path, polygon or polyline of a file whose control points can be moved.

    - `element`: index of its element in document order, from 0 for the root.
    - `attribute`: name of the attribute in which its points are written.
    - `first`: index of its first control point in `SvgControls.points`.
    - `path`: the path as it is in the file, in the user units of its element.
    """

    element: int
    attribute: str
    first: int
    path: Path


class SvgControls(eqx.Module):
    """Scene of a drawing, with the affine map from the drawing's control points to its vertices.

    - `scene`: the scene as `read_svg` returns it.
    - `points`: control points of all filled paths, polygons and polylines whose points are written
      in an attribute, `(x, y)` in the user units of their elements, in document order. An element
      that is drawn several times has its points here once.
    - `controls`, `weights`: for each vertex, the indices in `points` of four control points, and
      their weights. The weighted sum is the vertex in the user units of its element.
    - `linear`, `offset`: for each vertex, the map from the user units of its element to pixels: a
      vertex v in user units lies at `linear @ v + offset`.
    - `constant_vertices`: number of vertices that move with no control point, for each reason.
      `"cut"`: vertices where shapes cross, or where a shape is clipped or divided. `"radius"`:
      vertices on arcs, circles, ellipses and rects, and on paths that a style sheet gives.
      `"other"`: vertices of strokes, images, `colortri` and `textri`.

    A constant vertex has weights of zero, and its position as `offset`. Vertices that are added
    inside of a translucent fill also count as `"cut"`; the image does not depend on where they lie.
    """

    scene: Scene
    points: Float[Array, "points 2"]
    controls: Int[Array, "vertices 4"]
    weights: Float[Array, "vertices 4"]
    linear: Float[Array, "vertices 2 2"]
    offset: Float[Array, "vertices 2"]
    constant_vertices: Mapping[str, int] = eqx.field(static=True)
    _document: Document = eqx.field(static=True)
    _paths: tuple[ControlledPath, ...] = eqx.field(static=True)

    def positions(self, points: Float[Array, "points 2"]) -> Float[Array, "vertices 2"]:
        """Compute the vertices of the scene, in pixels, from control points. Differentiable.

        `points` are in the user units of their elements, like `self.points`. The result has their
        dtype.
        """
        weights, linear, offset = (
            array.astype(points.dtype) for array in (self.weights, self.linear, self.offset)
        )
        if len(points) == 0:
            return offset
        combined = jnp.einsum("vk,vkc->vc", weights, points[self.controls])
        return jnp.einsum("vij,vj->vi", linear, combined) + offset

    def moved(self, points: Float[Array, "points 2"]) -> Scene:
        """The scene with its vertices at `positions(points)`. Differentiable."""
        return replace(self.scene, positions=self.positions(points))

    def matrix(self) -> Any:
        """The linear part of the map from control points to vertices, as a `scipy.sparse` matrix.

        The float64 matrix `[2 vertices, 2 points]`, in CSR format, maps `points.ravel()` to
        `positions(points).ravel() - offset.ravel()`.
        """
        from scipy import sparse

        count = len(self.controls)
        weights, linear = np.asarray(self.weights, np.float64), np.asarray(self.linear, np.float64)
        controls = np.asarray(self.controls)
        # [vertices, axis of the vertex, control, axis of the control]
        values = np.einsum("vk,vij->vikj", weights, linear)
        rows = np.broadcast_to(
            2 * np.arange(count)[:, None, None, None] + np.arange(2)[:, None, None], values.shape
        )
        columns = np.broadcast_to(
            2 * controls[:, None, :, None] + np.arange(2)[None, None, None], values.shape
        )
        # Constant vertices name control 0, with a weight of 0, even if there is none.
        is_used = values != 0
        entries = (values[is_used], (rows[is_used], columns[is_used]))
        return sparse.coo_matrix(entries, (2 * count, 2 * len(self.points))).tocsr()

    def text(self, points: Any = None) -> str:
        """The text of the SVG file with `points` as its control points, by default `self.points`.

        Only the attributes in which control points are written change: numbers are rounded to
        float32, and commands become absolute. Raises `ValueError` for points of another shape or
        that are not finite in float32, for a file that is not in ASCII or UTF-8, and for an
        attribute that only a DTD gives.
        """
        with np.errstate(over="ignore"):
            points = np.asarray(self.points if points is None else points).astype(np.float32)
        if points.shape != self.points.shape:
            raise ValueError(f"`points` must have shape {self.points.shape}; got {points.shape}.")
        if not np.isfinite(points).all():
            raise ValueError("`points` must be finite in float32.")
        texts = {}
        for path in self._paths:
            path_points = points[path.first : path.first + len(path.path.points)]
            write = _path_data if path.attribute == "d" else _point_list
            texts[path.element] = (path.attribute, write(path.path, path_points))
        return _with_attributes(self._document, texts)


def make_controls(
    document: Document,
    root: Element,
    scene: Scene,
    triangles: Triangles,
    canvas: Canvas,
    sources: list[FillSource],
) -> SvgControls:
    """Find the control points on which each vertex of a drawing's scene depends.

    A vertex that depends on no control point is constant in the result; `SvgControls` lists the
    reasons.

    - `document`, `root`: the file, and the root of its elements.
    - `scene`: the scene of the drawing. Its vertices 3k to 3k + 2 are the corners of triangle k.
    - `triangles`: the same triangles. Their field `draw` is the index, in draw order, of the shape
      to which each triangle belongs.
    - `canvas`: its field `sources` maps the index in draw order of a filled shape to an index in
      `sources`.
    - `sources`: the filled shapes, each with its flattened path and its map to pixels.

    Raises `ValueError` if the map of a source to pixels is in perspective.
    """
    paths = _controlled_paths(root, sources)
    first = {id(element): path.first for element, path in paths}
    points = np.array([p for _, path in paths for p in path.path.points]).reshape(-1, 2)
    vertices = np.asarray(triangles.corners).reshape(-1, 2)
    source_of_draw = np.full(int(triangles.draw.max(initial=-1)) + 1, -1)
    for draw, source in canvas.sources.items():
        if draw < len(source_of_draw):
            source_of_draw[draw] = source
    source = np.repeat(source_of_draw[triangles.draw], 3)
    row = _matching_rows(vertices, source, sources)
    controls, weights, linear, offset = _source_points(sources, first)
    is_matched = row >= 0
    # The last row stands for vertices without a match.
    is_controlled = np.append((controls >= 0).all(axis=1), False)[row]
    is_linear = is_matched & is_controlled
    linear_rows = row[is_linear]
    result_controls = np.zeros((len(vertices), 4), np.int32)
    result_weights = np.zeros((len(vertices), 4))
    result_linear = np.zeros((len(vertices), 2, 2))
    result_offset = vertices.astype(np.float64)
    result_controls[is_linear] = controls[linear_rows]
    result_weights[is_linear] = weights[linear_rows]
    result_linear[is_linear] = linear[linear_rows]
    result_offset[is_linear] = offset[linear_rows]
    counts = {
        "cut": int(((source >= 0) & ~is_matched).sum()),
        "radius": int((is_matched & ~is_linear).sum()),
        "other": int((source < 0).sum()),
    }
    dtype = scene.positions.dtype
    return SvgControls(
        scene,
        jnp.asarray(points, dtype),
        jnp.asarray(result_controls),
        jnp.asarray(result_weights, dtype),
        jnp.asarray(result_linear, dtype),
        jnp.asarray(result_offset, dtype),
        _Counts(counts),
        document,
        _Paths(path for _, path in paths),
    )


class _Counts(dict):
    """A dictionary of counts by name.

    It is hashable by identity, because static fields of modules must be hashable.
    """

    __hash__ = object.__hash__  # type: ignore[assignment]


class _Paths(tuple):
    """A tuple of `ControlledPath`. It is hashable by identity, because a `Path` is not hashable."""

    __hash__ = object.__hash__  # type: ignore[assignment]


def _controlled_paths(
    root: Element, sources: list[FillSource]
) -> list[tuple[Element, ControlledPath]]:
    """The elements whose control points can be moved, with their paths, in document order.

    These are the paths, polygons and polylines that were filled, and whose points are written in an
    attribute rather than in a style sheet.
    """
    by_element = {id(source.element): source for source in sources}
    paths, first = [], 0
    for number, element in enumerate(elements(root)):
        source = by_element.get(id(element))
        attribute = _ATTRIBUTE.get(element.name)
        if source is None or attribute not in element.attrib or not source.is_from_attribute:
            continue
        paths.append((element, ControlledPath(number, attribute, first, source.path)))
        first += len(source.path.points)
    return paths


def _source_points(
    sources: list[FillSource], first: dict[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """List the points of all flattened shapes, with the control points on which each depends.

    - `sources`: the filled shapes. Their points are listed one shape after the other.
    - `first`: by Python's `id` of each element whose control points can be moved, the index of its
      first control point.

    Returns for each point the indices and weights of its four control points, and the linear map
    and the offset from user units to pixels. Indices are -1 for a point that depends on no control
    point. Raises `ValueError` for a map in perspective.
    """
    controls, weights, linear, offset = [], [], [], []
    for source in sources:
        count = len(source.flat_path.points)
        start = first.get(id(source.element), -1)
        within_path = source.flat_path.controls
        is_controlled = (within_path >= 0) & (start >= 0)
        controls.append(np.where(is_controlled, within_path + start, -1))
        weights.append(source.flat_path.weights)
        if source.map3[2, :2].any():
            raise ValueError(
                "control points have no affine map under a `transform` in perspective."
            )
        map3 = source.map3 / source.map3[2, 2]
        linear.append(np.broadcast_to(map3[:2, :2], (count, 2, 2)))
        offset.append(np.broadcast_to(map3[:2, 2], (count, 2)))
    if not controls:
        return np.zeros((0, 4), int), np.zeros((0, 4)), np.zeros((0, 2, 2)), np.zeros((0, 2))
    return (
        np.concatenate(controls),
        np.concatenate(weights),
        np.concatenate(linear),
        np.concatenate(offset),
    )


def _matching_rows(
    vertices: Float[np.ndarray, "vertices 2"],
    source: Int[np.ndarray, " vertices"],
    sources: list[FillSource],
) -> Int[np.ndarray, " vertices"]:
    """For each vertex, the row in `_source_points` of a point that equals it in float32, or -1.

    `vertices` are in pixels. `source` is the index in `sources` of the shape of each vertex, or -1.
    Only points of that shape are compared.
    """
    if not sources:
        return np.full(len(vertices), -1)
    mapped, owner = [], []
    for index, shape in enumerate(sources):
        homogeneous = shape.flat_path.points @ shape.map3[:, :2].T + shape.map3[:, 2]
        mapped.append(homogeneous[:, :2] / homogeneous[:, 2:])
        owner.append(np.full(len(homogeneous), index))
    # Adding zero makes -0 and 0 the same bits.
    keys = [
        np.ascontiguousarray(points.astype(np.float32) + np.float32(0)).view(np.uint64).ravel()
        for points in (np.concatenate(mapped), vertices)
    ]
    owners = [np.concatenate(owner), source]
    unique, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    combined = np.concatenate(owners) * len(unique) + inverse.ravel()
    known, wanted = combined[: len(keys[0])], combined[len(keys[0]) :]
    order = np.argsort(known, kind="stable")
    position = np.searchsorted(known[order], wanted)
    row = order[np.minimum(position, len(order) - 1)]
    return np.where((known[row] == wanted) & (source >= 0), row, -1)


def _number(value: float) -> str:
    """The decimal text of a number with the fewest digits that round to the same float32."""
    return str(np.float32(value)).removesuffix(".0")


def _pair(point: np.ndarray) -> str:
    """The x and y of a point as text, with a blank between."""
    return f"{_number(point[0])} {_number(point[1])}"


def _point_list(path: Path, points: np.ndarray) -> str:
    """The value of the attribute `points` with these points, `[n, 2]`.

    `path` is not used; it makes the signature that of `_path_data`.
    """
    return " ".join(map(_pair, points))


def _path_data(path: Path, points: np.ndarray) -> str:
    """The value of the attribute `d` of a path, with `points` as its control points.

    All commands are absolute.
    """
    words = []
    for subpath in path.subpaths:
        words.append(f"M{_pair(points[subpath.start])}")
        for segment in subpath.segments:
            if isinstance(segment, Arc):
                words.append(_arc_data(segment, points[segment.end]))
            else:
                command = "LQC"[len(segment) - 1]
                words.append(command + " ".join(_pair(points[index]) for index in segment))
        if subpath.closed:
            words.append("Z")
    return "".join(words)


def _arc_data(arc: Arc, end: np.ndarray) -> str:
    """The path command `A` that draws `arc` from the current point to the point `end`.

    Radii, rotation and flags are those of `arc`, even if its ends have been moved.
    """
    rx, ry = np.hypot(*arc.major), np.hypot(*arc.minor)
    rotation = np.degrees(np.arctan2(arc.major[1], arc.major[0]))
    flags = f"{int(abs(arc.turn) > np.pi)} {int(arc.turn > 0)}"
    return f"A{_number(rx)} {_number(ry)} {_number(rotation)} {flags} {_pair(end)}"


_NAME = re.compile(rb"""[^\s/<>]*+""")
"""Matches the name of an element, after `<`."""

_PAIR = re.compile(rb"""\s*+([^\s=/<>"']++)\s*+=\s*+("[^"]*+"|'[^']*+')""")
"""Matches the next attribute of a start tag: its name, and its value with quotes."""


def _with_attributes(document: Document, texts: dict[int, tuple[str, str]]) -> str:
    """The text of a document with new values of attributes.

    `texts` maps the index in document order of each element to change to the name of an attribute
    and its new value. Raises `SvgError` for a document that is not in ASCII or UTF-8, and for an
    attribute that is not written in its start tag.
    """
    data = document.data
    starts: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: starts.append(parser.CurrentByteIndex)
    parser.Parse(data, True)
    pieces, end = [], 0
    for number in sorted(texts):
        name, value = texts[number]
        position = starts[number] + 1
        position = _NAME.match(data, position).end()  # type: ignore[union-attr]
        while (match := _PAIR.match(data, position)) and match[1] != name.encode():
            position = match.end()
        if match is None:
            raise SvgError(
                f"{document.name}: control points can be written only to a file in ASCII or UTF-8 "
                f"that has the attribute {name!r} in the start tag, not from a DTD."
            )
        pieces += [data[end : match.start(2)], b'"', value.encode(), b'"']
        end = match.end(2)
    try:
        return b"".join([*pieces, data[end:]]).decode()
    except UnicodeDecodeError:
        raise SvgError(
            f"{document.name}: control points can be written only to a file in ASCII or UTF-8."
        ) from None
