"""Mesh fits: colours equal dense least squares, and predicted gains equal actual ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr
from softras2d.fitting.mesh import full_size
from softras2d.fitting.mesh.collapse import collapse
from softras2d.fitting.mesh.colors import ColorModel, mesh_pixels, solve_colors
from softras2d.fitting.mesh.edge_flips import flip, flip_edges, flip_gains, flippable_edges
from softras2d.fitting.mesh.evaluation import evaluate
from softras2d.fitting.mesh.exchange import exchange
from softras2d.fitting.mesh.full_size import colors_at_full_size
from softras2d.fitting.mesh.insertion import insert, split
from softras2d.fitting.mesh.splits import best_splits
from softras2d.fitting.mesh.start import delaunay_start, error_start, uniform_start
from softras2d.fitting.mesh.triangulation import check_tiling, find_edges, make_mesh
from softras2d.fitting.target import Target
from tests.cases.pictures import blobs, draw

HEIGHT, WIDTH = 32, 48
MODELS = ["vertex", "triangle", "linear"]
SEEDS = st.integers(0, 2**32 - 1)


def _error(mesh, target, model: ColorModel = "vertex"):
    picture = draw(mesh, solve_colors(mesh, target, model=model), model=model)
    return float(((picture - target.image) ** 2).sum())


def _edge_set(mesh):
    return {frozenset(ends) for ends in find_edges(mesh.triangles).ends.tolist()}


def _noise(seed):
    return Target(np.random.default_rng(seed).random((HEIGHT, WIDTH, 3)))


def _smooth():
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    disc = (np.hypot(x - 20, y - 15) < 9).astype(float)
    return Target(np.stack([disc, 0.5 + 0.4 * np.sin(x / 9), y / HEIGHT], -1))


@pytest.mark.parametrize("vertices", [4, 5, 7, 60, 333])
def test_uniform_starts_have_exactly_the_given_number_of_vertices(vertices):
    for jitter in (0.0, 0.4):
        mesh = uniform_start(HEIGHT, WIDTH, vertices, jitter=jitter, seed=1)
        check_tiling(mesh)
        assert len(mesh.positions) == vertices
        assert (mesh.height, mesh.width) == (HEIGHT, WIDTH)


@pytest.mark.parametrize("asked", [(0, 5, 9), (5, 5, 3)])
def test_empty_images_and_too_few_vertices_are_refused(asked):
    with pytest.raises(ValueError, match="four vertices"):
        uniform_start(*asked)


@pytest.mark.parametrize("model", MODELS)
def test_a_picture_of_the_mesh_gets_its_colours_back(model):
    rng = np.random.default_rng(0)
    mesh = uniform_start(HEIGHT, WIDTH, 24, jitter=0.3)
    shape = {"vertex": (24,), "triangle": (len(mesh.triangles),)}
    wanted = rng.random((*shape.get(model, (len(mesh.triangles), 3)), 3))
    target = Target(draw(mesh, wanted, model=model))
    np.testing.assert_allclose(solve_colors(mesh, target, model=model), wanted, atol=1e-3)
    np.testing.assert_allclose(_error(mesh, target, model), 0, atol=1e-5)


@given(seed=SEEDS, model=st.sampled_from(MODELS))
def test_colours_match_dense_least_squares(seed, model):
    target, mesh = _noise(seed), uniform_start(HEIGHT, WIDTH, 24, jitter=0.3, seed=seed)
    weights = np.random.default_rng(seed).uniform(0.5, 2, (HEIGHT, WIDTH))
    pairs = mesh_pixels(mesh)
    unknowns = {"vertex": mesh.triangles, "triangle": np.arange(len(mesh.triangles))[:, None]}
    of_corner = unknowns.get(model, np.arange(mesh.triangles.size).reshape(-1, 3))
    of_corner = np.broadcast_to(of_corner, mesh.triangles.shape)
    matrix = np.zeros((HEIGHT * WIDTH, of_corner.max() + 1))
    for n, (triangle, pixel) in enumerate(zip(pairs.triangle, pairs.pixel, strict=True)):
        for corner in range(3):
            matrix[pixel, of_corner[triangle, corner]] += pairs.weights[corner, n]
    root = np.sqrt(weights.reshape(-1, 1))
    wanted = np.linalg.lstsq(root * matrix, root * target.image.reshape(-1, 3))[0]
    solved = solve_colors(mesh, Target(target.image, weights), model=model)
    np.testing.assert_allclose(solved.reshape(wanted.shape), wanted, atol=2e-3)


@pytest.mark.parametrize("model", MODELS)
def test_triangles_without_pixels_take_colours_near_by(model):
    target = Target(np.full((HEIGHT, WIDTH, 3), 0.25))
    mesh = uniform_start(HEIGHT, WIDTH, 2 * HEIGHT * WIDTH)
    solved = solve_colors(mesh, target, model=model)
    np.testing.assert_allclose(solved, 0.25, atol=1e-9)


def test_predicted_gain_of_a_split_is_the_drop_with_other_colours_fixed():
    target, mesh = _noise(3), uniform_start(HEIGHT, WIDTH, 12)
    evaluation = evaluate(mesh, target, "vertex")
    splits = best_splits(mesh, evaluation, least_area=1.0)
    old = solve_colors(mesh, target)
    for number in range(len(splits.gain)):
        finer = split(mesh, splits, np.array([number]))
        check_tiling(finer)
        # The new vertex is the last one. Its hat function is the image of a mesh with colour 1 at
        # this vertex and 0 at all others.
        hat = draw(finer, np.eye(13)[:, 12:])
        residual = target.image - draw(mesh, old)
        drop = ((hat * residual).sum((0, 1)) ** 2).sum() / ((hat**2).sum() + 0.1)
        np.testing.assert_allclose(splits.gain[number], drop, rtol=1e-6)


@pytest.mark.parametrize("model", ["triangle", "linear"])
def test_predicted_gain_is_the_drop_where_triangles_are_on_their_own(model):
    target, mesh = _noise(4), uniform_start(HEIGHT, WIDTH, 12, jitter=0.3)
    evaluation = evaluate(mesh, target, model)
    splits = best_splits(mesh, evaluation, least_area=1.0)
    before, drops = _error(mesh, target, model), []
    for number in range(len(splits.gain)):
        finer = split(mesh, splits, np.array([number]))
        drops.append(before - _error(finer, target, model))
    # If the new vertex lies on a pixel centre, any of the triangles around it may contain the
    # pixel, and the prediction may assign the pixel to another triangle than the drawing does.
    close = np.isclose(splits.gain, drops, atol=2e-3)
    assert close.mean() > 0.7
    np.testing.assert_allclose(splits.gain, drops, atol=1.0)


def test_predicted_gain_of_a_flip_is_the_drop_with_four_colours_free():
    target, mesh = _noise(6), uniform_start(HEIGHT, WIDTH, 20, jitter=0.3)
    evaluation = evaluate(mesh, target, "vertex")
    edges = flippable_edges(mesh, 0.5)
    gains = flip_gains(mesh, target, evaluation, edges)
    before = ((draw(mesh, evaluation.colors) - target.image) ** 2).sum()
    assert len(gains) > 20
    for number, gain in enumerate(gains):
        flipped = flip(mesh, edges, np.array([number]))
        check_tiling(flipped)
        quad = np.concatenate([edges.ends[number], edges.apexes[number]])
        hats = draw(flipped, np.eye(20)[:, quad]).reshape(-1, 4)
        left = (target.image - draw(flipped, evaluation.colors)).reshape(-1, 3)
        after = left - hats @ np.linalg.lstsq(hats, left)[0]
        np.testing.assert_allclose(gain, before - (after**2).sum(), atol=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_flips_find_the_diagonal_of_the_picture(model):
    corners = np.array([[0.0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]])
    true, false = (
        make_mesh(corners, np.array(triangles), height=HEIGHT, width=WIDTH)
        for triangles in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]])
    )
    drawn = {"vertex": np.array([[0.0], [1], [0], [1]]), "triangle": np.array([[0.0], [1]])}
    solved = drawn.get(model, np.array([[[0.0], [1], [0]], [[1], [0], [0]]]))
    target = Target(draw(true, solved, model=model))
    flipped = flip_edges(false, target, model=model)
    check_tiling(flipped)
    assert _edge_set(flipped) == _edge_set(true)
    assert flip_edges(flipped, target, model=model) is flipped


@pytest.mark.parametrize("model", MODELS)
def test_a_vertex_that_shows_nothing_is_the_first_to_go(model):
    # Vertices are added inside triangles of a coarse mesh that makes the picture exactly.
    coarse = uniform_start(HEIGHT, WIDTH, 12)
    shape = {"vertex": (12, 3), "triangle": (len(coarse.triangles), 3)}
    solved = np.random.default_rng(1).random(shape.get(model, (len(coarse.triangles), 3, 3)))
    target = Target(draw(coarse, solved, model=model))
    splits = best_splits(coarse, evaluate(coarse, target, model), least_area=1.0)
    fine = split(coarse, splits, np.arange(len(coarse.triangles)))
    for _ in range(6):
        before = fine
        fine = collapse(fine, target, len(fine.positions) - 12, model=model)
        check_tiling(fine)
        assert len(fine.positions) < len(before.positions)
        if len(fine.positions) == 12:
            break
    np.testing.assert_allclose(_error(fine, target, model), 0, atol=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_exchanges_keep_the_count_and_lower_the_error(model):
    target, mesh = _smooth(), uniform_start(HEIGHT, WIDTH, 100)
    before = _error(mesh, target, model)
    for _ in range(5):
        mesh = exchange(mesh, target, 20, model=model)
        check_tiling(mesh)
        assert len(mesh.positions) == 100
    assert _error(mesh, target, model) < 0.5 * before


@pytest.mark.parametrize("model", MODELS)
def test_an_error_start_is_better_than_an_even_one(model):
    target = _smooth()
    mesh = error_start(target, 120, model=model)
    check_tiling(mesh)
    assert len(mesh.positions) == 120
    again = error_start(target, 120, model=model)
    np.testing.assert_array_equal(again.positions, mesh.positions)
    even = uniform_start(HEIGHT, WIDTH, 120)
    assert _error(mesh, target, model) < 0.6 * _error(even, target, model)


def test_an_error_start_has_more_vertices_where_weights_are_large():
    target = _noise(5)
    weights = np.where(np.arange(WIDTH) < WIDTH // 2, 1.0, 1e-3) * np.ones((HEIGHT, 1))
    share_at_left = [
        (error_start(Target(target.image, w), 100).positions[:, 0] < WIDTH / 2).mean()
        for w in (None, weights)
    ]
    assert share_at_left[1] > share_at_left[0] + 0.2


def test_nothing_to_gain_ends_the_start():
    mesh = error_start(Target(np.zeros((HEIGHT, WIDTH, 3))), 500)
    check_tiling(mesh)
    assert len(mesh.positions) < 500


def test_a_delaunay_start_is_denser_where_the_image_changes():
    target = _noise(7)
    target.image[:, : WIDTH // 2] = 0.5
    mesh = delaunay_start(target, 200)
    check_tiling(mesh)
    assert len(mesh.positions) == 200
    inside = mesh.positions[mesh.free_x & mesh.free_y]
    assert (inside[:, 0] > WIDTH / 2 - 3).mean() > 0.8
    np.testing.assert_array_equal(delaunay_start(target, 200).positions, mesh.positions)
    assert (delaunay_start(target, 200, seed=1).positions != mesh.positions).any()
    left = np.where(np.arange(WIDTH) < WIDTH // 2, 1.0, 0.0) * np.ones((HEIGHT, 1))
    weighed = delaunay_start(Target(_noise(7).image, left), 200).positions
    assert (weighed[:, 0] < WIDTH / 2).mean() > 0.7


@pytest.mark.parametrize("vertices", [4, 5, 9, 5000])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (16, 16)])
def test_a_delaunay_start_of_any_size_tiles(size, vertices):
    mesh = delaunay_start(Target(np.full((*size, 3), 0.3)), vertices)
    check_tiling(mesh)
    assert len(mesh.positions) <= vertices


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 2)])
def test_tiny_targets(size):
    target = Target(np.random.default_rng(0).random((*size, 3)))
    mesh = error_start(target, 50)
    check_tiling(mesh)
    check_tiling(insert(mesh, target, 5, least_area=0.01))


def test_an_error_start_can_be_ended_early():
    target = _noise(0)
    looks = iter([False, True, True, True])
    mesh = error_start(target, 200, must_start=lambda: next(looks))
    assert 60 <= len(mesh.positions) < 200
    check_tiling(mesh)


class TestColorsAtFullSize:
    def test_strips_give_the_colors_of_all_pixels(self, monkeypatch):
        image = blobs(60, 50)
        weights = np.linspace(0.5, 1.5, 3000, dtype=np.float32).reshape(60, 50)
        target = Target(image, weights)
        mesh = uniform_start(60, 50, 30, jitter=0.2)
        monkeypatch.setattr(full_size, "_STRIP_PIXELS", 350)
        for model in ("vertex", "triangle", "linear"):
            summed = colors_at_full_size(mesh, target, model=model)
            np.testing.assert_allclose(summed, solve_colors(mesh, target, model=model), atol=1e-9)

    @pytest.mark.slow
    def test_a_fit_at_half_size_has_the_colors_of_the_whole_target(self):
        """The target has fine stripes, which are grey if it is shrunk."""
        target = blobs(48, 64)
        target[:, ::2] = 0.0
        result = sr.fit(target, family="mesh", triangles=20, size=32, steps=10)
        positions = np.asarray(result.scene.positions, np.float64)
        mesh = make_mesh(positions, np.asarray(result.scene.triangles), height=48, width=64)
        best = np.clip(solve_colors(mesh, Target(target)), 0, 1)
        corner_colors = best[np.asarray(result.scene.triangles)]
        np.testing.assert_allclose(result.scene.colors, corner_colors, atol=1e-4)
