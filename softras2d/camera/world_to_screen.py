"""View and projection matrices, and the projection of a mesh to a scene.

`softras2d.camera` (`__init__.py`) states the conventions of matrices and spaces.
"""

import math
from typing import Any

import numpy as np

from ..numerics.device import is_traced, to_device
from ..scene import Scene, check
from ..texture.pyramid import TexturePyramid
from .near_plane import ClippedTriangles, clip_near


def look_at(eye: Any, target: Any, up: Any = (0.0, 1.0, 0.0)) -> np.ndarray:
    """View matrix `[4, 4]` of a viewer at `eye` who sees `target` in the middle of the image.

    The matrix maps world space to view space, where the viewer is at the origin and looks along -z.
    `up` is a direction in world space that points upwards in the image; it need not be a unit
    vector, nor at a right angle to the line of sight.

    Raises `ValueError` if an argument is not three finite numbers, if `target` equals `eye`, or if
    `up` is zero or (almost) parallel to the line between them.
    """
    eye, target, up = (
        _numbers(name, value, (3,))
        for name, value in (("eye", eye), ("target", target), ("up", up))
    )
    forward = target - eye
    right = np.cross(forward, up)
    # The cross product of parallel vectors is not exactly 0, but about 1e-16 of their lengths.
    if not np.linalg.norm(right) > 1e-12 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise ValueError(
            "`target` must differ from `eye`, and `up` must not be parallel to the line between "
            "them; "
            f"got eye {eye.tolist()}, target {target.tolist()}, up {up.tolist()}."
        )
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(right, forward), -forward
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def perspective(
    fov_y_degrees: float | int, aspect: float | int, near: float | int, far: float | int
) -> np.ndarray:
    """Perspective projection matrix `[4, 4]`, from view space to clip space.

    In clip space, w is the distance from the viewer along the line of sight. The depth, z / w, is 0
    on the near plane and 1 on the far plane.

    - `fov_y_degrees`: vertical field of view, in degrees, above 0 and below 180.
    - `aspect`: width / height of the image, positive and finite.
    - `near`, `far`: distances of the planes from the viewer, 0 < near < far; `far` may be infinite.

    Raises `ValueError` for numbers outside these ranges, and for values of other types.
    """
    given = (fov_y_degrees, aspect, near, far)
    are_numbers = all(isinstance(value, float | int | np.number) for value in given)
    if not (are_numbers and 0 < fov_y_degrees < 180 and 0 < aspect < math.inf and 0 < near < far):
        raise ValueError(
            "a projection needs 0 < `fov_y_degrees` < 180, `aspect` > 0 and 0 < `near` < `far`; "
            f"got {', '.join(map(repr, given))}."
        )
    focal = 1.0 / math.tan(math.radians(fov_y_degrees) / 2)
    # far / (far - near), written so that it is 1 for an infinite `far`.
    depth_scale = 1.0 / (1.0 - near / far)
    return np.array(
        [
            [focal / aspect, 0.0, 0.0, 0.0],
            [0.0, focal, 0.0, 0.0],
            [0.0, 0.0, -depth_scale, -depth_scale * near],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )


def project(
    vertices: Any,
    triangles: Any,
    *,
    height: int,
    width: int,
    view: Any,
    projection: Any,
    model: Any = None,
    vertex_colors: Any = None,
    triangle_colors: Any = None,
    uv: Any = None,
    texture_index: Any = None,
    textures: TexturePyramid | None = None,
    background: Any = None,
) -> Scene:
    """Project a mesh in space to the scene that the viewer sees.

    The scene has depth (z / w) and `inverse_w` (1 / w) at each vertex, so that it is rendered with
    a z-buffer and perspective-correct interpolation.

    - `vertices`: `[vertices, 3]`, in the space that `model` maps to world space; without `model`,
      in world space.
    - `triangles`: `[triangles, 3]` vertex indices, in draw order.
    - `height`, `width`: size of the image, in pixels.
    - `model`, `view`, `projection`: matrices `[4, 4]`, applied in this order; `model` is the
      identity by default.
    - `vertex_colors` or `triangle_colors`, and the rest: as for `Scene.from_mesh`.

    Triangles that cross the near plane are clipped: each becomes one or two triangles, next to each
    other in draw order, with colours and uv interpolated along the cut edges. Triangles on the
    viewer's side of the near plane, also those behind the viewer, are dropped, and so are vertices
    without triangles. Nothing is clipped at the far plane or at the borders of the image.

    `project` runs on the host, in numpy and float64, and rounds once to float32. It needs concrete
    values and has no derivatives with respect to them. Only `textures` and `background` may be
    traced: they are only converted to float32.

    Raises `ValueError` for shapes, indices and values that a scene cannot have, for other traced
    arguments, for a size that is no positive integer, for a singular `view` or `projection`, and if
    `projection` maps a point of a triangle with z >= 0 to w <= 0 or beyond the range of float32.
    """
    given = (vertices, triangles, model, vertex_colors, triangle_colors, uv, texture_index)
    _check_arguments((given, view, projection), height, width)
    vertices = _numbers("vertices", vertices, (None, 3))
    # This scene is only made to check the arguments before clipping, so that errors name indices of
    # the caller's arrays.
    unclipped = Scene.from_mesh(
        np.zeros((len(vertices), 2), np.float32),
        triangles,
        vertex_colors=vertex_colors,
        triangle_colors=triangle_colors,
        uv=uv,
        texture_index=texture_index,
        background=background,
        textures=textures,
    )
    triangles = np.asarray(unclipped.triangles)
    matrix = _invertible("projection", projection) @ _invertible("view", view)
    if model is not None:
        matrix = matrix @ _numbers("model", model, (4, 4))
    clipped = clip_near(_transformed(matrix, vertices), triangles)
    on_screen = _to_screen(clipped, height, width)
    clipped_uv = clipped_texture_index = None
    if uv is not None:
        clipped_uv = to_device(clipped.interpolate(np.asarray(uv, np.float64)), np.float32)
        clipped_texture_index = to_device(np.asarray(texture_index)[clipped.source], np.int32)
    if vertex_colors is not None:
        colors = np.asarray(vertex_colors, np.float64)[triangles]
    else:
        colors = np.asarray(triangle_colors, np.float64).reshape(unclipped.colors.shape)
    scene = Scene(
        positions=to_device(on_screen[:, :2]),
        triangles=to_device(clipped.triangles, np.int32),
        colors=to_device(clipped.interpolate(colors), np.float32),
        background=unclipped.background,
        uv=clipped_uv,
        texture_index=clipped_texture_index,
        textures=unclipped.textures,
        depth=to_device(on_screen[:, 2]),
        inverse_w=to_device(on_screen[:, 3]),
    )
    check(scene)
    return scene


def _check_arguments(arrays: Any, height: Any, width: Any) -> None:
    """Raise `ValueError` for traced arrays, and for an image size that is no positive integer."""
    if is_traced(arrays):
        raise ValueError("`project` needs concrete values: call it outside jit, vmap and grad.")
    if not all(isinstance(side, int | np.integer) and side >= 1 for side in (height, width)):
        raise ValueError(
            f"`height` and `width` must be positive integers; got {height!r} and {width!r}."
        )


def _to_screen(clipped: ClippedTriangles, height: int, width: int) -> np.ndarray:
    """Divide clipped vertices by w, and map them to an image of `height` x `width` pixels.

    Returns `[vertices, 4]` float32: x and y in pixels, depth, and 1 / w. Raises `ValueError` if one
    of these is not finite or 1 / w is not positive, and names the first input triangle with such a
    vertex.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, y, z, w = clipped.vertices.T
        columns = [(1 + x / w) * (width / 2), (1 - y / w) * (height / 2), z / w, 1 / w]
        screen = np.stack(columns, axis=-1).astype(np.float32)
    is_valid = np.isfinite(screen).all(axis=1) & (screen[:, 3] > 0)
    for bad in np.flatnonzero(~is_valid[clipped.triangles].all(axis=1))[:1]:
        raise ValueError(
            "beyond the near plane (z >= 0) `projection` must give finite points with w > 0; "
            f"it does not for triangle {clipped.source[bad]}."
        )
    return screen


def _transformed(matrix: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Multiply a matrix `[4, 4]` by vertices (x, y, z, 1), given as `[vertices, 3]`.

    Returns `[vertices, 4]`. The product is written out because equal vertices must give bitwise
    equal results, which a BLAS product does not promise.
    """
    x, y, z = vertices.T[:, :, None]
    # `_to_screen` reports what overflows.
    with np.errstate(over="ignore", invalid="ignore"):
        return x * matrix[:, 0] + y * matrix[:, 1] + z * matrix[:, 2] + matrix[:, 3]


def _invertible(name: str, value: Any) -> np.ndarray:
    """Return `value` as a 4x4 float64 matrix; raise `ValueError` unless it is invertible."""
    matrix = _numbers(name, value, (4, 4))
    if np.linalg.matrix_rank(matrix) < 4:
        raise ValueError(f"`{name}` must be invertible; got {matrix.tolist()}.")
    return matrix


def _numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return `value` as a float64 array of finite numbers.

    Raises `ValueError` for other values and for another shape than `shape`, in which None stands
    for any size. `name` is the argument that the message names.
    """
    wanted = f"`{name}` must be [{', '.join(str(size or 'n') for size in shape)}] finite numbers"
    try:
        array = np.asarray(value)
        fits = array.dtype.kind in "biuf" and len(array.shape) == len(shape)
    except ValueError as error:
        raise ValueError(f"{wanted}; got rows of unequal length.") from error
    if not fits or any(a not in (None, b) for a, b in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{wanted}; got {array.dtype} of shape {array.shape}.")
    for where in np.argwhere(~np.isfinite(array))[:1]:
        raise ValueError(f"{wanted}; {where.tolist()} has {array[tuple(where)]}.")
    return array.astype(np.float64)
