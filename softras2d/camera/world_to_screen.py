"""From vertices in space to a scene: the matrices of a viewer, the near plane, the viewport.

Matrices are 4x4 in float64 and act on columns (x, y, z, 1).

- **View space** is right-handed: x right, y up, and the viewer at the origin looks down -z.
- **Clip space** is (x, y, z, w). The picture is -w..w across and up; z is 0 on the near plane, w
  on the far one.
- **Depth** is z / w: 0 on the near plane, 1 on the far one, growing away.
"""

import math
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from ..numerics.device import to_device
from ..scene import Scene, check
from ..texture.pyramid import TexturePyramid
from .near_plane import Cut, cut_near


def look_at(eye: Any, target: Any, up: Any = (0.0, 1.0, 0.0)) -> np.ndarray:
    """World to view space for a viewer at `eye` who sees `target` in the middle, `up` upwards.

    Raises `ValueError` where those leave a direction open.
    """
    eye, target, up = (
        _numbers(name, value, (3,))
        for name, value in (("eye", eye), ("target", target), ("up", up))
    )
    forward = target - eye
    right = np.cross(forward, up)
    # Rounding alone leaves a part in 1e16 of parallel ones.
    if not np.linalg.norm(right) > 1e-12 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise ValueError(
            "`target` must lie apart from `eye`, and `up` off the line between them; "
            f"got {eye.tolist()}, {target.tolist()}, {up.tolist()}."
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
    """View to clip space: w is the distance along the line of sight; depth is 0..1.

    - `fov_y_degrees`: the angle from the lower to the upper border of the picture.
    - `aspect`: width / height.
    - `near`, `far`: distances with 0 < near < far; `far` may be infinite.

    Raises `ValueError` for numbers outside these ranges.
    """
    given = (fov_y_degrees, aspect, near, far)
    numbers = all(isinstance(value, float | int | np.number) for value in given)
    if not (numbers and 0 < fov_y_degrees < 180 and 0 < aspect < math.inf and 0 < near < far):
        raise ValueError(
            "wanted 0 < `fov_y_degrees` < 180, `aspect` > 0 and 0 < `near` < `far`; "
            f"got {', '.join(map(repr, given))}."
        )
    focal = 1.0 / math.tan(math.radians(fov_y_degrees) / 2)
    # far / (far - near), which has a limit for far at infinity.
    stretch = 1.0 / (1.0 - near / far)
    return np.array(
        [
            [focal / aspect, 0.0, 0.0, 0.0],
            [0.0, focal, 0.0, 0.0],
            [0.0, 0.0, -stretch, -stretch * near],
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
    """The scene that the viewer sees, with `depth` z / w and `inverse_w` 1 / w at each vertex.

    - `vertices` `[vertices, 3]`, `triangles` `[triangles, 3]`, in draw order.
    - `model`, `view`, `projection`: applied in this order; `model` is the identity unless given.
    - `vertex_colors` or `triangle_colors`, and the rest: as for `Scene.from_mesh`.

    Triangles that reach in front of the near plane are clipped there, into one or two that stay
    next to each other in the draw order; colours and uv are interpolated along the cut edges.
    Triangles wholly in front of it are dropped, and so are vertices that no triangle is left to
    use. Nothing is cut at the far plane or at the borders.

    Host side: numpy in float64, rounded once to float32. Needs concrete values, and has no
    derivatives in them; `textures` and `background` are passed on as they are. Raises `ValueError`
    for shapes, indices and values that no scene has, for a singular `view` or `projection`, and
    for what a `projection` sends to w <= 0 beyond its near plane.
    """
    given = (vertices, triangles, model, vertex_colors, triangle_colors, uv, texture_index)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((given, view, projection))):
        raise ValueError("`project` needs concrete values: call it outside jit, vmap and grad.")
    if not all(isinstance(side, int | np.integer) and side >= 1 for side in (height, width)):
        raise ValueError(
            f"`height` and `width` must be positive integers; got {height!r} and {width!r}."
        )
    vertices = _numbers("vertices", vertices, (None, 3))
    rest: dict[str, Any] = {"background": background, "textures": textures}
    # The scene's own checks, before the cut renumbers what they would name.
    whole = Scene.from_mesh(
        np.zeros((len(vertices), 2), np.float32),
        triangles,
        vertex_colors=vertex_colors,
        triangle_colors=triangle_colors,
        uv=uv,
        texture_index=texture_index,
        **rest,
    )
    triangles = np.asarray(whole.triangles)
    matrix = _invertible("projection", projection) @ _invertible("view", view)
    if model is not None:
        matrix = matrix @ _numbers("model", model, (4, 4))
    cut = cut_near(_transformed(matrix, vertices), triangles)
    seen = _on_screen(cut, height, width)
    if uv is not None:
        rest["uv"] = cut.carry(np.asarray(uv, np.float64))
        rest["texture_index"] = np.asarray(texture_index)[cut.owner]
    if vertex_colors is not None:
        colors = np.asarray(vertex_colors, np.float64)[triangles]
    else:
        colors = np.asarray(triangle_colors, np.float64).reshape(whole.colors.shape)
    scene = Scene(
        positions=to_device(seen[:, :2]),
        triangles=to_device(cut.triangles, np.int32),
        colors=to_device(cut.carry(colors), np.float32),
        background=whole.background,
        uv=to_device(rest["uv"], np.float32) if uv is not None else None,
        texture_index=to_device(rest["texture_index"], np.int32) if uv is not None else None,
        textures=whole.textures,
        depth=to_device(seen[:, 2]),
        inverse_w=to_device(seen[:, 3]),
    )
    check(scene)
    return scene


def _on_screen(cut: Cut, height: int, width: int) -> np.ndarray:
    """`[vertices, 4]` in float32: x and y in pixels, depth and 1 / w.

    Raises `ValueError` for the first triangle that cannot be shown.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, y, z, w = cut.vertices.T
        seen = [(1 + x / w) * (width / 2), (1 - y / w) * (height / 2), z / w, 1 / w]
        seen = np.stack(seen, axis=-1).astype(np.float32)
    shown = np.isfinite(seen).all(axis=1) & (seen[:, 3] > 0)
    for bad in np.flatnonzero(~shown[cut.triangles].all(axis=1))[:1]:
        raise ValueError(
            "beyond the near plane (z >= 0) `projection` must give finite points with w > 0; "
            f"it does not for triangle {cut.owner[bad]}."
        )
    return seen


def _transformed(matrix: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Clip space of `vertices`, equal for equal vertices, which a BLAS does not promise."""
    x, y, z = vertices.T[:, :, None]
    # What is too large for float64 is refused on the screen.
    with np.errstate(over="ignore", invalid="ignore"):
        return x * matrix[:, 0] + y * matrix[:, 1] + z * matrix[:, 2] + matrix[:, 3]


def _invertible(name: str, value: Any) -> np.ndarray:
    matrix = _numbers(name, value, (4, 4))
    if np.linalg.matrix_rank(matrix) < 4:
        raise ValueError(f"`{name}` must be invertible; got {matrix.tolist()}.")
    return matrix


def _numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Finite float64 of a shape, in which None is any size."""
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
