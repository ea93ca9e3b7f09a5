"""Three ways to add multisampling to a simple z-buffer; only the last one is right.

Each function draws one triangle after another at the samples `points [size, size, samples, 2]`, and
returns the frame `[size, size, 3]` and how many times a colour was evaluated. The functions differ
in what they store for a pixel between two triangles.
"""

from collections.abc import Callable, Sequence

import numpy as np

from .samples import Triangle, color_of_pixels

Drawing = tuple[np.ndarray, int]


def one_depth(drawn: Sequence[Triangle], points: np.ndarray, background: np.ndarray) -> Drawing:
    """Wrong: a pixel stores one depth, of its nearest covered sample, and one colour.

    The stored colour is the triangle's colour times the triangle's share of the samples. On the
    silhouette of a near triangle, the pixel stores this fraction and nothing else, since triangles
    behind it are deeper than the one depth. Over a black background, such a pixel looks right; in
    front of another triangle, it is part of a black line.
    """
    frame = _empty(points, background)
    depth = np.full(points.shape[:2], np.inf)
    shaded = 0
    for triangle in drawn:
        box = triangle.box(len(points))
        covered = triangle.covers(points[box])
        nearest = np.where(covered, triangle.depth_at(points[box]), np.inf).min(axis=-1)
        passed = covered.any(axis=-1) & (nearest <= depth[box])
        chosen = covered & passed[..., None]
        share = chosen.mean(axis=-1)[passed][:, None]
        frame[box][passed] = color_of_pixels(triangle, points[box], chosen) * share
        depth[box][passed] = nearest[passed]
        shaded += int(passed.sum())
    return frame, shaded


def frame_as_store(
    drawn: Sequence[Triangle], points: np.ndarray, background: np.ndarray
) -> Drawing:
    """Wrong: each sample stores its depth, but colours are blended into the pixel at once.

    A triangle is blended into the frame by its share of the samples. That is right for two
    triangles drawn back to front. Otherwise a later triangle, which covers other samples, also
    reduces the weight of the earlier one, so that the background shows through.
    """
    frame = _empty(points, background)
    depth = np.full(points.shape[:3], np.inf)
    shaded = 0
    for triangle in drawn:
        box = triangle.box(len(points))
        chosen = _pass_depth_test(triangle, points[box], depth[box])
        found = chosen.any(axis=-1)
        share = chosen.mean(axis=-1)[found][:, None]
        color = color_of_pixels(triangle, points[box], chosen)
        frame[box][found] = frame[box][found] * (1 - share) + color * share
        shaded += int(found.sum())
    return frame, shaded


def per_sample(drawn: Sequence[Triangle], points: np.ndarray, background: np.ndarray) -> Drawing:
    """Right: each sample stores its depth and its colour; a pixel is the mean of its samples.

    All triangles are tested for depth first, so that only visible ones are shaded.
    """
    owner = owners(drawn, points)
    store = np.repeat(_empty(points, background)[:, :, None], points.shape[2], axis=2)
    shaded = 0
    for index, triangle in enumerate(drawn):
        box = triangle.box(len(points))
        is_owner = owner[box] == index
        is_visible = is_owner.any(axis=-1)
        color = color_of_pixels(triangle, points[box], is_owner)
        store[box][is_visible] = np.where(
            is_owner[is_visible][..., None], color[:, None], store[box][is_visible]
        )
        shaded += int(is_visible.sum())
    return store.mean(axis=2), shaded


def owners(drawn: Sequence[Triangle], points: np.ndarray) -> np.ndarray:
    """The triangle visible at each sample, `[size, size, samples]`; -1: none."""
    depth = np.full(points.shape[:3], np.inf)
    owner = np.full(points.shape[:3], -1)
    for index, triangle in enumerate(drawn):
        box = triangle.box(len(points))
        owner[box][_pass_depth_test(triangle, points[box], depth[box])] = index
    return owner


def _pass_depth_test(triangle: Triangle, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The samples where a triangle passes the depth test; its depth is stored there."""
    triangle_depth = triangle.depth_at(points)
    passed = triangle.covers(points) & (triangle_depth <= depth)
    depth[passed] = triangle_depth[passed]
    return passed


def _empty(points: np.ndarray, background: np.ndarray) -> np.ndarray:
    return np.broadcast_to(background, (*points.shape[:2], 3)).astype(np.float64)


VARIANTS: dict[str, Callable[[Sequence[Triangle], np.ndarray, np.ndarray], Drawing]] = {
    "a: one depth a pixel": one_depth,
    "b: depth a sample, frame as store": frame_as_store,
    "c: depth and colour a sample": per_sample,
}
