"""Meshes tile the canvas after every change, and cover each pixel centre exactly once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softras2d.fitting.mesh.collapse import collapse
from softras2d.fitting.mesh.colors import mesh_pixels
from softras2d.fitting.mesh.edge_flips import flip_edges, flip_to_delaunay
from softras2d.fitting.mesh.insertion import insert
from softras2d.fitting.mesh.start import uniform_start
from softras2d.fitting.mesh.triangulation import (
    check_tiling,
    find_edges,
    greedy_disjoint,
    make_mesh,
    signed_areas,
)
from softras2d.fitting.mesh.untangle import untangle
from softras2d.fitting.target import Target

HEIGHT, WIDTH = 24, 36
SEEDS = st.integers(0, 2**32 - 1)


def _mesh(seed, vertices=40):
    return uniform_start(HEIGHT, WIDTH, vertices, jitter=0.4, seed=seed)


def _square(**changes):
    positions = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [1, 2]])
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return make_mesh(positions, triangles, height=4, width=4)._replace(**changes)


def test_areas_and_edges_of_a_square_by_hand():
    mesh = _square()
    check_tiling(mesh)
    assert (mesh.height, mesh.width) == (4, 4)
    np.testing.assert_array_equal(signed_areas(mesh.positions, mesh.triangles), [4, 6, 4, 2])
    np.testing.assert_array_equal(mesh.free_x, [False] * 4 + [True])
    edges = find_edges(mesh.triangles)
    assert len(edges.ends) == 8 and (edges.triangles[:, 1] < 0).sum() == 4
    for ends, sides, apexes, starts in zip(*edges, strict=True):
        for side, apex, start, (a, b) in zip(
            sides, apexes, starts, (ends, ends[::-1]), strict=True
        ):
            if side >= 0:
                np.testing.assert_array_equal(np.roll(mesh.triangles[side], -start), [a, b, apex])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [5, 2]])}, "flipped"),
        ({"positions": np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [0, 2]])}, "flipped or empty"),
        ({"positions": np.full((5, 2), np.nan)}, "finite"),
        ({"positions": np.array([[0.0, 0], [4, 0], [4, 3], [0, 4], [1, 2]])}, "sum"),
        ({"triangles": np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4]])}, "sum"),
        ({"triangles": np.array([[0, 1, 2], [0, 2, 3]])}, "every vertex"),
        ({"triangles": np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]])}, "sum|same direction"),
        ({"free_x": np.ones(5, bool)}, "borders"),
    ],
)
def test_what_is_no_tiling_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        check_tiling(_square(**changes))


def test_greedy_disjoint_takes_the_best_first():
    claims = np.array([[0, 1], [1, 2], [2, -1], [3, -1]])
    np.testing.assert_array_equal(greedy_disjoint(np.array([1.0, 3, 2, 0]), claims, 4), [1, 3])


@given(seed=SEEDS)
def test_every_pixel_centre_has_one_triangle(seed):
    mesh = _mesh(seed)
    # The second mesh has vertices and edges on pixel centres.
    snapped = untangle(mesh, np.floor(mesh.positions) + 0.5)
    for tiling in (mesh, snapped):
        pairs = mesh_pixels(tiling)
        assert sorted(pairs.pixel) == list(range(HEIGHT * WIDTH))
        assert (pairs.weights > -1e-9).all()
        corners = tiling.positions[tiling.triangles[pairs.triangle]]
        centers = np.einsum("ip,pid->pd", pairs.weights, corners)
        np.testing.assert_allclose(centers[:, 0], pairs.pixel % WIDTH + 0.5, atol=1e-9)
        np.testing.assert_allclose(centers[:, 1], pairs.pixel // WIDTH + 0.5, atol=1e-9)
        ones = np.ones(len(pairs.pixel))
        np.testing.assert_array_equal(
            pairs.sum_by_triangle(ones),
            np.bincount(pairs.triangle, minlength=len(tiling.triangles)),
        )


@given(seed=SEEDS)
def test_delaunay_flips_leave_every_circle_empty(seed):
    target = Target(np.random.default_rng(seed).random((HEIGHT, WIDTH, 3)))
    mesh = flip_to_delaunay(insert(_mesh(seed), target, 20))
    check_tiling(mesh)
    for corners in mesh.positions[mesh.triangles]:
        # All corners p satisfy |p - center|^2 = radius^2 on the circumscribed circle. Subtracting
        # two of these equations leaves one that is linear in the center.
        squares = (corners**2).sum(1)
        center = np.linalg.solve(2 * (corners[1:] - corners[0]), squares[1:] - squares[0])
        distance = np.linalg.norm(mesh.positions - center, axis=1)
        radius = np.linalg.norm(corners[0] - center)
        assert distance.min() > radius * (1 - 1e-6)


@given(seed=SEEDS, model=st.sampled_from(["vertex", "triangle", "linear"]), reach=st.floats(0, 50))
def test_any_sequence_of_changes_keeps_a_tiling(seed, model, reach):
    rng = np.random.default_rng(seed)
    target = Target(rng.random((HEIGHT, WIDTH, 3)))
    mesh = _mesh(seed, 20)
    for _ in range(3):
        mesh = insert(mesh, target, 8, model=model)
        check_tiling(mesh)
        mesh = untangle(mesh, mesh.positions + rng.normal(0, reach, mesh.positions.shape))
        check_tiling(mesh)
        mesh = flip_edges(mesh, target, model=model, rounds=2)
        check_tiling(mesh)
        before = len(mesh.positions)
        mesh = collapse(mesh, target, 5, model=model)
        check_tiling(mesh)
        assert before - 5 <= len(mesh.positions) <= before


@given(seed=SEEDS)
def test_small_moves_are_made_in_full_and_large_ones_in_part(seed):
    rng = np.random.default_rng(seed)
    mesh = _mesh(seed)
    free = np.stack([mesh.free_x, mesh.free_y], 1)
    small = np.where(free, mesh.positions + rng.uniform(-0.05, 0.05, free.shape), mesh.positions)
    np.testing.assert_allclose(untangle(mesh, small).positions, small, atol=1e-12)
    far = mesh.positions.copy()
    far[np.flatnonzero(free.all(1))[0]] += 1000.0
    moved = untangle(mesh, far)
    check_tiling(moved)
    assert np.isfinite(moved.positions).all()
    bad = np.full_like(far, np.nan)
    np.testing.assert_array_equal(untangle(mesh, bad).positions, mesh.positions)


def test_a_mesh_collapses_to_its_corners():
    target = Target(np.random.default_rng(0).random((HEIGHT, WIDTH, 3)))
    mesh = _mesh(0)
    for _ in range(60):
        mesh = collapse(mesh, target, 10, least_area=0.0)
        check_tiling(mesh)
    assert len(mesh.positions) == 4
    assert collapse(mesh, target, 10) is mesh
