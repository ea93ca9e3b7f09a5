"""Cameras: matrices and projections worked by hand, clipping at the near plane, and errors."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr
from softras2d.camera import look_at, perspective, project

EYE = np.eye(4)
"""The view matrix of a viewer at the origin who looks down -z."""

BARYCENTRIC = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
"""Texture coordinates that equal the barycentric weights of corners 1 and 2."""


def project_white(vertices, triangles, *, view=EYE, projection=None, size=(60, 80), **rest) -> Any:
    """Project white triangles, by default seen at 90 degrees with the near plane at z = -1."""
    height, width = size
    if projection is None:
        projection = perspective(90.0, width / height, 1.0, 9.0)
    if "vertex_colors" not in rest:
        rest.setdefault("triangle_colors", np.ones((len(triangles), 3)))
    return project(
        vertices, triangles, height=height, width=width, view=view, projection=projection, **rest
    )


def traceable(triangles) -> dict:
    """Options of `project` that trace each clipped corner back to its original triangle.

    The texture coordinates are barycentric weights, and texture indices are triangle indices.
    """
    count = len(triangles)
    return {
        "uv": np.broadcast_to(BARYCENTRIC, (count, 3, 2)),
        "texture_index": np.arange(count),
        "textures": sr.TexturePyramid.build([np.ones((1, 1, 3), np.float32)] * max(1, count)),
    }


class TestMatrices:
    def test_look_at_from_the_front_only_moves(self):
        view = look_at((0, 0, 5), (0, 0, 0), (0, 1, 0))
        np.testing.assert_array_equal(
            view, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -5], [0, 0, 0, 1]]
        )

    def test_look_at_from_the_side_rotates(self):
        # From +x towards the origin: -z is to the right, y is up, and +x is towards the viewer.
        view = look_at((3, 0, 0), (0, 0, 0))
        in_view = view @ np.array([[0, 0, -1, 1], [0, 1, 0, 1], [1, 0, 0, 1]]).T
        np.testing.assert_allclose(
            in_view.T[:, :3], [[1, 0, -3], [0, 1, -3], [0, 0, -2]], atol=1e-15
        )

    @given(st.lists(st.floats(-5, 5), min_size=9, max_size=9))
    def test_look_at_is_a_rigid_motion(self, numbers):
        eye, target, up = np.array(numbers).reshape(3, 3)
        if np.linalg.norm(np.cross(target - eye, up)) < 1e-3:
            return
        view = look_at(eye, target, up)
        np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1.0)
        np.testing.assert_allclose(view @ np.append(eye, 1), [0, 0, 0, 1], atol=1e-12)
        away = np.linalg.norm(target - eye)
        np.testing.assert_allclose(
            view @ np.append(target, 1), np.array([0, 0, -away, 1]), atol=1e-11
        )
        assert (view[:3, :3] @ up)[0] == pytest.approx(0.0, abs=1e-11)
        assert (view[:3, :3] @ up)[1] > 0

    def test_perspective_by_hand(self):
        # tan(45 degrees) is 1; far / (far - near) is 5 / 4.
        expected = [[0.5, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.25, -2.5], [0, 0, -1, 0]]
        np.testing.assert_allclose(perspective(90.0, 2.0, 2.0, 10.0), expected, rtol=1e-15)

    @pytest.mark.parametrize("far", [7.0, 1e9, math.inf])
    def test_depth_is_zero_to_one(self, far):
        matrix = perspective(50.0, 1.0, 0.3, far)
        _, _, z, w = matrix @ [0, 0, -0.3, 1]
        assert (z, w) == (0.0, 0.3)
        _, _, z, w = matrix @ [0, 0, -min(far, 1e12), 1]
        assert z / w == pytest.approx(1.0)

    @pytest.mark.parametrize(
        "call",
        [
            lambda: look_at((0, 0, 0), (0, 0, 0)),
            lambda: look_at((0, 0, 0), (0, 2, 0), (0, 1, 0)),
            lambda: look_at((0, 0, 0), (0.1, 0.2, 0.3), (-0.3, -0.6, -0.9)),
            lambda: look_at((0, 0), (0, 2, 0)),
            lambda: look_at((0, 0, math.nan), (0, 2, 0)),
            lambda: perspective(0.0, 1.0, 0.1, 50.0),
            lambda: perspective(180.0, 1.0, 0.1, 50.0),
            lambda: perspective(45.0, math.nan, 0.1, 50.0),
            lambda: perspective(45.0, 1.0, 0.0, 50.0),
            lambda: perspective(45.0, 1.0, 50.0, 0.1),
        ],
    )
    def test_errors_are_one_line(self, call):
        with pytest.raises(ValueError, match=r"^[^\n]*`(eye|target|fov_y_degrees)`[^\n]*$"):
            call()


class TestViewport:
    def test_y_points_down_and_the_axis_meets_the_middle(self):
        scene = project_white([(0, 0, -2), (2, 0, -2), (0, 2, -2)], [[0, 1, 2]])
        np.testing.assert_allclose(scene.positions, [[40, 30], [70, 30], [40, 0]], atol=1e-5)
        np.testing.assert_allclose(scene.inverse_w, [0.5] * 3)
        # (9 / 8) (1 - 1 / 2).
        np.testing.assert_allclose(scene.depth, [0.5625] * 3)

    def test_the_scene_of_a_z_buffer_exercise_by_hand(self):
        vertices = [
            (2, 0, -2), (0, 2, -2), (-2, 0, -2), (3.5, -1, -5), (2.5, 1.5, -5), (-1, 0.5, -5),
        ]  # fmt: skip
        scene = project_white(
            vertices,
            [[0, 1, 2], [3, 4, 5]],
            view=look_at((0, 0, 5), (0, 0, 0)),
            projection=perspective(45.0, 1.0, 0.1, 50.0),
            size=(700, 700),
        )
        # 1 / tan(22.5 degrees) is 1 + sqrt 2; the triangles are 7 and 10 away.
        near, far = 350 * (1 + math.sqrt(2)) / 7, 350 * (1 + math.sqrt(2)) / 10
        expected = [
            (350 + 2 * near, 350), (350, 350 - 2 * near), (350 - 2 * near, 350),
            (350 + 3.5 * far, 350 + far), (350 + 2.5 * far, 350 - 1.5 * far),
            (350 - far, 350 - 0.5 * far),
        ]  # fmt: skip
        np.testing.assert_allclose(scene.positions, expected, rtol=1e-7)
        np.testing.assert_allclose(scene.inverse_w, [1 / 7] * 3 + [1 / 10] * 3, rtol=1e-7)
        depth = [50 / 49.9 * (1 - 0.1 / away) for away in (7, 10)]
        np.testing.assert_allclose(scene.depth, np.repeat(depth, 3), rtol=1e-7)
        assert (np.asarray(scene.triangles) == [[0, 1, 2], [3, 4, 5]]).all()

    def test_model_is_applied_before_view(self):
        model = np.array([[0, -2, 0, 1], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1.0]])
        view = look_at((1, 2, 6), (0, 0, 0))
        points = np.array([(0, 0, 0), (1, 0, 0.5), (0, 1, -0.5)])
        moved = np.stack([1 - 2 * points[:, 1], 2 * points[:, 0], 2 * points[:, 2]], -1)
        one = project_white(points, [[0, 1, 2]], view=view, model=model)
        other = project_white(moved, [[0, 1, 2]], view=view)
        np.testing.assert_allclose(one.positions, other.positions, rtol=1e-6)
        np.testing.assert_allclose(one.depth, other.depth, rtol=1e-6)

    def test_an_orthographic_projection_is_affine(self):
        flat = np.diag([0.5, 0.5, -0.1, 1.0])
        scene = project_white([(0, 0, -1), (2, 0, -5), (0, 2, -9)], [[0, 1, 2]], projection=flat)
        np.testing.assert_allclose(scene.positions, [[40, 30], [80, 30], [40, 0]])
        np.testing.assert_array_equal(scene.inverse_w, 1.0)
        np.testing.assert_allclose(scene.depth, [0.1, 0.5, 0.9])

    def test_a_flattening_model_is_a_shadow(self):
        onto_the_ground = np.diag([1.0, 0.0, 1.0, 1.0])
        scene = project_white(
            [(0, 5, -3), (1, 2, -3), (0, 1, -4)], [[0, 1, 2]], model=onto_the_ground
        )
        np.testing.assert_allclose(scene.positions[:, 1], 30.0)

    def test_colors_textures_and_background_are_passed_on(self):
        textures = sr.TexturePyramid.build([np.ones((2, 2, 3), np.float32)])
        uv = np.arange(12.0).reshape(2, 3, 2)
        scene = project_white(
            [(0, 0, -2), (1, 0, -2), (0, 1, -2), (1, 1, -3)],
            [[0, 1, 2], [1, 2, 3]],
            vertex_colors=[(1, 0, 0, 1), (0, 1, 0, 0.5), (0, 0, 1, 0), (1, 1, 1, 1)],
            uv=uv,
            texture_index=[0, -1],
            textures=textures,
            background=[0.1, 0.2, 0.3],
        )
        np.testing.assert_array_equal(scene.uv, uv)
        np.testing.assert_array_equal(scene.texture_index, [0, -1])
        assert scene.textures is textures
        np.testing.assert_allclose(scene.background, [0.1, 0.2, 0.3])
        np.testing.assert_array_equal(scene.colors[1, 1], [0, 0, 1, 0])

    def test_arrays_are_float32_for_any_input(self, float64):
        scene = project_white(
            np.array([(0, 0, -2), (1, 0, -2), (0, 1, -2)], np.float64), [[0, 1, 2]]
        )
        floats = (scene.positions, scene.colors, scene.depth, scene.inverse_w, scene.background)
        assert {str(array.dtype) for array in floats if array is not None} == {"float32"}


class TestNearPlane:
    def test_two_corners_behind_by_hand(self):
        # The tip is 3 in front of the eye and the base 1 behind it. The near plane, 1 in front,
        # cuts both sides in the middle.
        vertices = [(0, 0, -3), (2, 0, 1), (0, 2, 1)]
        scene = project_white(vertices, [[0, 1, 2]], vertex_colors=np.eye(3))
        np.testing.assert_allclose(scene.positions, [[40, 30], [70, 30], [40, 0]], atol=1e-5)
        np.testing.assert_allclose(scene.inverse_w, [1 / 3, 1, 1])
        np.testing.assert_array_equal(scene.depth[1:], 0.0)
        np.testing.assert_allclose(scene.colors, [[[1, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5]]])

    def test_one_corner_behind_makes_two_in_order(self):
        vertices = [(0, 0, -3), (2, 0, -3), (0, 2, 1), (1, 1, -4), (1, 0, 2), (2, 0, 2)]
        triangles = [[3, 0, 1], [0, 1, 2], [3, 0, 1], [3, 4, 5], [2, 4, 5], [1, 0, 3]]
        scene = project_white(vertices, triangles, **traceable(triangles))
        np.testing.assert_array_equal(scene.texture_index, [0, 1, 1, 2, 3, 5])
        # Triangle 1 is cut in two. Both share an edge from its first corner in front of the plane.
        first, second = np.asarray(scene.triangles)[1:3]
        assert first[0] == second[0] and first[2] == second[1]

    @pytest.mark.parametrize(
        ("z", "count"),
        [
            ((-1, -1, -1), 1),  # lies in the plane
            ((-1, -1, -2), 1),
            ((-1, -1, 0), 0),  # touches the plane with an edge, from behind
            ((-1, 0, 0), 0),
            ((-1, -2, 0), 1),  # is cut by the plane through a corner
            ((-2, -2, -1), 1),
            ((0, 0, 0), 0),
        ],
    )
    def test_corners_on_the_plane_by_hand(self, z, count):
        vertices = np.stack([[0, 1, 0], [0, 0, 1], z], axis=-1)
        for turn in range(3):
            scene = project_white(np.roll(vertices, turn, axis=0), [[0, 1, 2]])
            assert len(scene.triangles) == count
            assert (np.asarray(scene.inverse_w) <= 1).all()

    def test_a_scene_behind_the_viewer_is_empty(self):
        scene = project_white([(0, 0, 1), (1, 0, 1), (0, 1, 1)], [[0, 1, 2]])
        assert scene.positions.shape == (0, 2) and scene.colors.shape == (0, 1, 3)
        empty = project_white(np.zeros((0, 3)), np.zeros((0, 3), int))
        assert empty.triangles.shape == (0, 3)

    def test_triangles_in_front_are_unchanged_to_the_bit(self):
        vertices = np.random.default_rng(0).uniform(-1, 1, (30, 3)) - [0, 0, 3]
        triangles = np.arange(30).reshape(10, 3)
        both = np.concatenate([triangles, [[0, 1, 30]]])
        alone = project_white(vertices, triangles)
        scene = project_white([*vertices, (0, 0, 5)], both)
        np.testing.assert_array_equal(alone.triangles, triangles)
        np.testing.assert_array_equal(scene.triangles[:10], triangles)
        np.testing.assert_array_equal(scene.positions[:30], alone.positions)
        assert scene.positions.shape == (32, 2)

    def test_neighbours_are_cut_at_equal_points(self):
        # Pairs of triangles on both sides of an edge through the plane. They share no vertices.
        random = np.random.default_rng(3)
        edge = random.uniform(-3, 3, (200, 2, 3))
        edge[:, :, 2] = random.uniform([-1.9, -0.1], [-1.1, 0.7], (200, 2))
        tips = random.uniform(-3, 3, (200, 2, 3))
        pairs = np.concatenate([edge, tips[:, :1], edge[:, ::-1], tips[:, 1:]], axis=1)
        triangles = np.arange(1200).reshape(-1, 3)
        view = look_at((0.1, 0.2, 0.3), (0, 0.1, -1))
        scene = project_white(pairs.reshape(-1, 3), triangles, view=view, **traceable(triangles))
        owner = np.asarray(scene.texture_index)
        uv = np.asarray(scene.uv)
        vertices = np.concatenate(
            [scene.positions, scene.depth[:, None], scene.inverse_w[:, None]], axis=-1
        )[np.asarray(scene.triangles)]
        # Inside the edge from corner 0 to corner 1, which both triangles of a pair share.
        on_edge = (uv[..., 1] == 0) & (uv[..., 0] > 0) & (uv[..., 0] < 1)
        compared = 0
        for pair in range(200):
            one, other = (
                {
                    tuple(row)
                    for row in vertices[on_edge & (owner == 2 * pair + side)[:, None]].tolist()
                }
                for side in (0, 1)
            )
            assert one == other
            compared += len(one)
        assert compared > 150

    @given(
        st.lists(st.tuples(*[st.integers(-3, 3)] * 3), min_size=3, max_size=7),
        st.data(),
    )
    def test_clipped_triangles_are_what_lies_in_front(self, vertices, data):
        """Clipped triangles are the part of each triangle in front of the near plane.

        They have the positions, attributes and areas of this part.
        """
        corner = st.integers(0, len(vertices) - 1)
        triangles = data.draw(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=5))
        colors = np.random.default_rng(0).random((len(triangles), 3, 4))
        scene = project_white(vertices, triangles, triangle_colors=colors, **traceable(triangles))
        owner = np.asarray(scene.texture_index)
        assert (np.diff(owner) >= 0).all()
        assert np.bincount(owner, minlength=1).max() <= 2
        bc = np.asarray(scene.uv, np.float64)
        weights = np.concatenate([1 - bc.sum(-1, keepdims=True), bc], axis=-1)
        assert weights.min(initial=0) >= -1e-6
        space = np.array(vertices, np.float64)[np.array(triangles)]
        x, y, z = np.moveaxis(weights @ space[owner], -1, 0)
        assert z.max(initial=-1) <= -1 + 1e-6
        corners = np.asarray(scene.triangles)
        expected = np.stack([40 - 30 * x / z, 30 + 30 * y / z], axis=-1)
        np.testing.assert_allclose(scene.positions[corners], expected, atol=1e-4)
        np.testing.assert_allclose(scene.inverse_w[corners], -1 / z, rtol=1e-5)
        np.testing.assert_allclose(scene.depth[corners], 1.125 * (1 + 1 / z), atol=1e-6)
        np.testing.assert_allclose(scene.colors, weights @ colors[owner], atol=1e-6)
        # The area in barycentric space is the share of the triangle in front of the plane.
        sides = bc[:, 1:] - bc[:, :1]
        area = np.abs(np.linalg.det(sides)) if len(bc) else np.zeros(0)
        for index, heights in enumerate(-1 - space[..., 2]):
            assert area[owner == index].sum() == pytest.approx(_share(heights), abs=1e-6)


def _share(heights: np.ndarray) -> float:
    """The share of a triangle where a linear function, given at its corners, is positive."""
    low, middle, high = sorted(heights.tolist())
    if high <= 0:
        return float(low == high == 0)
    if low >= 0:
        return 1.0
    if middle <= 0:
        return high**2 / ((high - low) * (high - middle))
    return 1 - low**2 / ((low - high) * (low - middle))


class TestErrors:
    GOOD = ([(0.0, 0.0, -2.0), (1.0, 0.0, -2.0), (0.0, 1.0, -2.0)], [[0, 1, 2]])

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"vertices": [(0, 0), (1, 1), (2, 0)]}, r"`vertices` must be \[n, 3\] .* \(3, 2\)"),
            ({"vertices": [(0, 0, 1), (1, 1)]}, "`vertices` must be .* unequal length"),
            ({"vertices": [(0, 0, "a")] * 3}, "`vertices` must be "),
            ({"vertices": [(0, 0, 1j)] * 3}, "`vertices` must be .* complex128"),
            ({"vertices": [(0, 0, math.inf)] * 3}, r"`vertices` .*; \[0, 2\] has inf"),
            ({"triangles": [[0, 1, 3]]}, "`triangles` must be in 0..2"),
            ({"triangles": [[0, 1]]}, "`triangles` must be "),
            ({"view": np.zeros((4, 4))}, "`view` must be invertible"),
            ({"view": np.eye(3)}, r"`view` must be \[4, 4\]"),
            ({"projection": np.diag([1, 1, 1, 0])}, "`projection` must be invertible"),
            ({"projection": np.full((4, 4), math.nan)}, "`projection` must be "),
            ({"model": np.eye(3)}, r"`model` must be \[4, 4\]"),
            # This projection gives w = -1 everywhere.
            ({"projection": np.diag([1, 1, -1, -1])}, "w > 0; it does not for triangle 0"),
            ({"vertices": [(0, 0, -2), (1e60, 0, -2), (0, 1, -2)]}, "finite points .* triangle 0"),
            ({"vertices": [(0, 0, -2), (1e308, 1e308, -1e308), (0, 1, -2)]}, "triangle 0"),
            ({"triangle_colors": None}, "one of `vertex_colors` and `triangle_colors`"),
            ({"triangle_colors": [(1, 1)]}, "`triangle_colors` must be "),
            ({"triangle_colors": [(1.0, 1.0, 1.0, 2.0)]}, "`colors alpha` must be in 0..1"),
            ({"uv": np.zeros((1, 3, 2))}, "go together"),
            ({"size": (0, 80), "projection": np.eye(4)}, "`height` and `width` must be positive"),
        ],
    )
    def test_invalid_input_is_refused_in_one_line(self, change, message):
        vertices, triangles = change.pop("vertices", None), change.pop("triangles", None)
        vertices = self.GOOD[0] if vertices is None else vertices
        triangles = self.GOOD[1] if triangles is None else triangles
        with pytest.raises(ValueError, match=message) as caught:
            project_white(vertices, triangles, **change)
        assert "\n" not in str(caught.value)

    def test_traced_vertices_are_refused(self):
        def first_depth(vertices):
            scene = project_white(vertices, self.GOOD[1])
            return scene.depth[0]

        with pytest.raises(ValueError, match="concrete"):
            jax.grad(first_depth)(jnp.array(self.GOOD[0]))


def test_the_module_is_a_public_name():
    assert sr.camera.project is project
    assert "camera" in dir(sr)
