"""Move the vertices of a mesh and change their colours by steps of the Gauss-Newton method.

The image of a mesh with one colour per vertex is continuous, so its derivative has no term at the
edges of triangles. Let phi be the hat function of a vertex: 1 at the vertex, and linear down to 0
at its neighbours. Where the image has the gradient g (a row of two numbers for each channel), a
change of the vertex's colour by c and of its position by p changes the image by phi (c - g p), to
first order. Products of such changes, summed over the pixels of a triangle, need only the sums of
products of hat functions that least squares for colours needs as well (`colors.Moments`).

A pixel is the mean of one sample or of 2 x 2 (see `_FEW_PIXELS`). In the second case, the matrix of
the normal equations is computed as if each sample were a pixel of a quarter of the weight. This
bounds the true matrix from above, since the square of a mean is at most the mean of the squares:
steps are a little shorter, but the matrix couples only vertices that share a triangle, in blocks of
5 x 5.

**Source:** Baines, *Algorithms for optimal piecewise linear and constant L2 fits to continuous
functions with adjustable nodes in one and two dimensions* (Math. Comp. 62, 1994); Marquardt (1963)
for the damping; Hestenes and Stiefel (1952) for conjugate gradients.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import bsr_array

from ...geometry.vectors import cross
from ..target import Target
from .colors import color_moments, interpolate, solve_colors, sum_by_vertex
from .pixel_weights import PixelWeights, pixel_weights
from .triangulation import Mesh
from .untangle import untangle

_UNKNOWNS = 5
"""Number of unknowns of a vertex: its colour, red, green and blue, and its position, x and y."""

_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-4, 1e2
"""Damping at first, its lower bound, and the bound above which the steps end.

The damping is the fraction of each diagonal entry of the matrix that is added to the entry."""

_DAMPING_FACTORS = 0.4, 8.0
"""Factors of the damping after a step that lowers the error, and after a try that does not."""

_COLOR_RIDGE, _POSITION_RIDGE = 1e-4, 1e-1
"""Numbers added to the diagonal of the matrix of the normal equations, whatever the damping is.

The first is for the colours, the second for the free coordinates. They keep vertices in place that
hardly change the image, as in a region of one colour."""

_LONGEST_MOVE = 1.5
"""Longest move of a vertex in one step, in pixels along each axis.

The image is linear in the position of a vertex only within about the size of the features of the
image."""

_MAX_ITERATIONS = 25
"""Maximum number of iterations of conjugate gradients for one step."""

_TOLERANCE = 1e-2
"""Conjugate gradients stop when the norm of the residual is at most this fraction of its norm at
the beginning (see `_conjugate_gradients`)."""

_FEW_PIXELS = 60.0
"""Number of pixels per triangle of a mesh, below which the mesh is drawn with 2 x 2 samples per
pixel.

A mesh with larger triangles is drawn with one sample per pixel, at its centre."""

VertexColors = Float[np.ndarray, "vertices 3"]
"""The RGB colour of each vertex."""

VertexValues = Float[np.ndarray, "vertices 5"]
"""A number for each unknown of each vertex, in the order red, green, blue, x, y."""


class _Drawing(NamedTuple):
    """The samples at which a mesh was drawn, and how its image differs from the target.

    - `pairs`: all pairs of a triangle and a sample in it, with the index of the sample as `pixel`.
    - `pixel`: index of the pixel of each pair's sample, row * width + column.
    - `samples_per_pixel`: number of samples of each pixel.
    - `residual`: the target minus the image, for each channel and pixel, not weighted.
    - `error_weights`: the weight of the error of each pixel; None: all are 1.
    - `error`: squared error, weighted and summed over pixels and channels.
    """

    pairs: PixelWeights
    pixel: Int[np.ndarray, " pairs"]
    samples_per_pixel: int
    residual: Float[np.ndarray, "channels pixels"]
    error_weights: Float[np.ndarray, " pixels"] | None
    error: float


class Moved(NamedTuple):
    """The result of `gauss_newton`.

    - `mesh`: the mesh with moved vertices.
    - `colors`: one RGB colour per vertex, in 0..1.
    - `steps`: number of steps that were taken.
    """

    mesh: Mesh
    colors: VertexColors
    steps: int


def move_vertices(
    mesh: Mesh, target: Target, steps: int, must_stop: Callable[[], bool] = lambda: False
) -> Mesh:
    """Move the vertices by up to `steps` steps of `gauss_newton`; return the moved mesh.

    The steps begin with the colours of least squared error, clipped to 0..1. The arguments are
    those of `gauss_newton`.
    """
    if must_stop():
        return mesh
    colors = np.clip(solve_colors(mesh, target), 0.0, 1.0)
    return gauss_newton(mesh, target, colors, steps, must_stop).mesh


def gauss_newton(
    mesh: Mesh,
    target: Target,
    colors: VertexColors,
    steps: int,
    must_stop: Callable[[], bool] = lambda: False,
) -> Moved:
    """Lower the squared error by up to `steps` steps that move vertices and change their colours.

    Each step lowers the error: one that does not is tried again with more damping, which shortens
    it. The steps end early if no step lowers the error, however it is damped. No triangle is
    flipped, vertices on a border stay on it, and colours stay in 0..1.

    - `mesh`, `target`: in pixels of the fit; the target has three channels.
    - `colors`: one RGB colour per vertex, in 0..1.
    - `must_stop()`: asked before each step; if it returns true, no further step begins.
    """
    layout = _layout(mesh)
    drawing = _draw(mesh, target, colors)
    damping = _FIRST_DAMPING
    for step in range(steps):
        if must_stop():
            return Moved(mesh, colors, step)
        gradient, blocks = _normal_equations(mesh, colors, drawing)
        entries = _add_blocks(layout, blocks)
        while True:
            change = _solve(layout, gradient, entries, damping)
            new_mesh, new_colors = _apply(mesh, colors, change)
            new_drawing = _draw(new_mesh, target, new_colors)
            if new_drawing.error < drawing.error:
                break
            damping *= _DAMPING_FACTORS[1]
            if damping > _MOST_DAMPING:
                return Moved(mesh, colors, step)
        mesh, colors, drawing = new_mesh, new_colors, new_drawing
        damping = max(_LEAST_DAMPING, damping * _DAMPING_FACTORS[0])
    return Moved(mesh, colors, steps)


def _draw(mesh: Mesh, target: Target, colors: VertexColors) -> _Drawing:
    """Draw a mesh with one sample per pixel, or with 2 x 2, and compare it with the target.

    `_FEW_PIXELS` decides the number of samples. `mesh` and `target` are in pixels of the fit.
    """
    side = 1 if mesh.height * mesh.width >= _FEW_PIXELS * len(mesh.triangles) else 2
    image, weights = target
    height, width, channels = image.shape
    pairs = pixel_weights(
        mesh.positions * side, mesh.triangles, height=height * side, width=width * side
    )
    row, column = np.divmod(pairs.pixel, width * side)
    pixel = row // side * width + column // side
    residual = image.reshape(-1, channels).T.astype(np.float64)
    for channel, values in enumerate(interpolate(pairs, colors[mesh.triangles])):
        residual[channel] -= np.bincount(pixel, values, height * width) / side**2
    squares = (residual**2).sum(0)
    error_weights = None if weights is None else weights.reshape(-1).astype(np.float64)
    error = squares.sum() if error_weights is None else squares @ error_weights
    return _Drawing(pairs, pixel, side**2, residual, error_weights, float(error))


def _normal_equations(
    mesh: Mesh, colors: VertexColors, drawing: _Drawing
) -> tuple[VertexValues, Float[np.ndarray, "triangles 3 3 5 5"]]:
    """Compute the right-hand side and the matrix of the normal equations of a Gauss-Newton step.

    The right-hand side is minus half the gradient of the squared error. The matrix is returned as
    one block of 5 x 5 for each pair of corners of each triangle. Blocks for the same two vertices,
    in the same order, are still to be added. With 2 x 2 samples per pixel, the matrix differs from
    the exact one as the module says.

    `drawing`: the mesh as `_draw` draws it in these colours.
    """
    pixel, weights = drawing.pixel, drawing.error_weights
    moments = color_moments(
        drawing.pairs, drawing.residual[:, pixel], None if weights is None else weights[pixel]
    )
    # What a unit change of each unknown, times the hat function, changes in each channel.
    effect = np.zeros((len(mesh.triangles), 3, _UNKNOWNS))
    effect[:, :, :3] = np.eye(3)
    effect[:, :, 3:] = -_color_gradients(mesh, colors)
    blocks = np.einsum("tij,tca,tcb->tijab", moments.matrix, effect, effect, optimize=True)
    # The target of these moments is the residual.
    by_corner = moments.weighted_target @ effect
    gradient = sum_by_vertex(mesh.triangles, by_corner, len(mesh.positions))
    return gradient / drawing.samples_per_pixel, blocks / drawing.samples_per_pixel


def _color_gradients(mesh: Mesh, colors: VertexColors) -> Float[np.ndarray, "triangles channels 2"]:
    """Derivative of each triangle's colour with respect to x and y, per pixel."""
    a, b, c = mesh.positions[mesh.triangles].transpose(1, 0, 2)
    ab, ac = b - a, c - a
    scaled_ab, scaled_ac = (edge / cross(ab, ac)[:, None] for edge in (ab, ac))
    a, b, c = colors[mesh.triangles].transpose(1, 0, 2)
    along_x = (b - a) * scaled_ac[:, 1:] - (c - a) * scaled_ab[:, 1:]
    along_y = (c - a) * scaled_ab[:, :1] - (b - a) * scaled_ac[:, :1]
    return np.stack([along_x, along_y], -1)


class _Layout(NamedTuple):
    """Where the blocks of the triangles lie in the matrix of the normal equations.

    An entry of the matrix is a block of 5 x 5 for a pair of vertices, its row and its column, that
    share a triangle or are the same vertex.

    - `order`: indices of the blocks of all triangles, 9 each, sorted by row and then by column.
    - `starts`: for each entry, the index in `order` of the first block that is added to it; the
      others follow.
    - `row`, `column`: the two vertices of each entry. Entries are sorted by row, then by column.
    - `is_fixed`: which unknowns may not change: the coordinates that a border fixes.
    """

    order: Int[np.ndarray, " blocks"]
    starts: Int[np.ndarray, " entries"]
    row: Int[np.ndarray, " entries"]
    column: Int[np.ndarray, " entries"]
    is_fixed: Bool[np.ndarray, "vertices 5"]


def _layout(mesh: Mesh) -> _Layout:
    """Make the layout of the matrix, which stays the same when vertices move."""
    count, triangles = len(mesh.positions), mesh.triangles.astype(np.int64)
    pair = (triangles[:, :, None] * count + triangles[:, None, :]).ravel()
    order = np.argsort(pair, kind="stable")
    pair, starts = np.unique(pair[order], return_index=True)
    row, column = np.divmod(pair, count)
    is_fixed = np.zeros((count, _UNKNOWNS), bool)
    is_fixed[:, 3], is_fixed[:, 4] = ~mesh.free_x, ~mesh.free_y
    return _Layout(order, starts, row, column, is_fixed)


def _add_blocks(
    layout: _Layout, blocks: Float[np.ndarray, "triangles 3 3 5 5"]
) -> Float[np.ndarray, "entries 5 5"]:
    """Sum the blocks of all triangles into the entries of the matrix, in the order of `layout`.

    Rows and columns of fixed unknowns are set to 0. `blocks`: one for each pair of corners of each
    triangle, as `_normal_equations` returns them.
    """
    sorted_blocks = blocks.reshape(-1, _UNKNOWNS, _UNKNOWNS)[layout.order]
    entries = np.add.reduceat(sorted_blocks, layout.starts, axis=0)
    is_fixed = layout.is_fixed
    return entries * (~is_fixed[layout.row][:, :, None] & ~is_fixed[layout.column][:, None, :])


def _solve(
    layout: _Layout,
    gradient: VertexValues,
    entries: Float[np.ndarray, "entries 5 5"],
    damping: float,
) -> VertexValues:
    """Solve the damped normal equations for the change of each unknown.

    The change of fixed unknowns is 0. The solution is approximate (see `_conjugate_gradients`).

    - `gradient`: the right-hand side.
    - `entries`: the entries of the matrix, without damping, as `_add_blocks` returns them.
    - `damping`: fraction of each diagonal entry that is added to the entry, besides
      `_COLOR_RIDGE` or `_POSITION_RIDGE`.
    """
    is_fixed, entries = layout.is_fixed, entries.copy()
    diagonal = np.flatnonzero(layout.row == layout.column)
    numbers = np.arange(_UNKNOWNS)
    ridge = np.array([_COLOR_RIDGE] * 3 + [_POSITION_RIDGE] * 2)
    added = damping * entries[diagonal][:, numbers, numbers] + ridge
    entries[diagonal[:, None], numbers, numbers] += np.where(is_fixed, 1.0, added)
    row_starts = np.searchsorted(layout.row, np.arange(len(is_fixed) + 1))
    size = is_fixed.size
    matrix = bsr_array((entries, layout.column, row_starts), shape=(size, size))
    return _conjugate_gradients(
        matrix, np.linalg.inv(entries[diagonal]), np.where(is_fixed, 0.0, gradient)
    )


def _conjugate_gradients(
    matrix: bsr_array,
    preconditioner: Float[np.ndarray, "vertices 5 5"],
    right_side: VertexValues,
) -> VertexValues:
    """Solve a linear system approximately by preconditioned conjugate gradients, starting at 0.

    The iterations end after `_MAX_ITERATIONS`, or as `_TOLERANCE` says. The norm of the residual r
    is the root of r^T P r, where P is the preconditioner.

    `preconditioner`: for each vertex, the inverse of its block on the diagonal of `matrix`.
    """
    solution, residual = np.zeros_like(right_side), right_side.copy()
    direction = preconditioned = np.einsum("vij,vj->vi", preconditioner, residual)
    product = first_product = (residual * preconditioned).sum()
    for _ in range(_MAX_ITERATIONS):
        if product <= _TOLERANCE**2 * first_product:
            break
        matrix_direction = (matrix @ direction.ravel()).reshape(direction.shape)
        step_length = product / (direction * matrix_direction).sum()
        solution += step_length * direction
        residual -= step_length * matrix_direction
        preconditioned = np.einsum("vij,vj->vi", preconditioner, residual)
        previous_product, product = product, (residual * preconditioned).sum()
        direction = preconditioned + product / previous_product * direction
    return solution


def _apply(mesh: Mesh, colors: VertexColors, change: VertexValues) -> tuple[Mesh, VertexColors]:
    """Return the mesh and its colours after `change`, which has a number to add to each unknown.

    Vertices move by at most `_LONGEST_MOVE` along each axis, and only as far as no triangle is
    flipped. Colours change in full, and are then clipped to 0..1.
    """
    move = np.clip(change[:, 3:], -_LONGEST_MOVE, _LONGEST_MOVE)
    return untangle(mesh, mesh.positions + move), np.clip(colors + change[:, :3], 0.0, 1.0)
