"""The map from control points to vertices is exact and differentiable, and can be written back."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 60 50" width="60" height="50">
<style>.a { fill: #c33 }</style>
<defs><path id="leaf" d="M 5 5 c 0 9 12 9 12 0 z"/></defs>
<g transform="rotate(10) translate(4 0)">
<use href="#leaf"/><use href='#leaf' x="20" opacity=".5"/></g>
<path class="a" d='M10 25 Q 30 15 50 25 T 50 45 L 12 42 Z m 8 4 v 8 h 9 z'/>
<polygon points="2,20 9,21 6,33" fill="#36c"/><circle cx="52" cy="8" r="5"/>
<path d="M3 44 A 9 9 0 0 1 20 46 L 10 49 z" stroke="black"/>
</svg>"""


@pytest.fixture
def controls(tmp_path):
    (tmp_path / "a.svg").write_text(DRAWING)
    return sr.read_svg_controls(tmp_path / "a.svg")


def moved_points(controls):
    shift = np.random.default_rng(0).uniform(-0.5, 0.5, controls.points.shape)
    return controls.points + jnp.asarray(shift, jnp.float32)


def test_the_file_s_points_give_the_scene(controls):
    scene = sr.read_svg(controls._document.name)
    np.testing.assert_array_equal(scene.positions, controls.scene.positions)
    np.testing.assert_allclose(controls.positions(controls.points), scene.positions, atol=2e-5)
    # All uses of the leaf share its control points, which are in the file once.
    assert len(controls.points) == 4 + 9 + 3 + 3
    np.testing.assert_allclose(controls.points[:3], [[5, 5], [5, 14], [17, 14]], atol=1e-6)


def test_constants_are_counted_and_named(controls):
    counts = controls.constant_vertices
    has_weights = np.asarray(controls.weights).any(axis=1)
    assert sum(counts.values()) == int((~has_weights).sum())
    assert set(counts) == {"cut", "radius", "other"}
    assert all(count > 0 for count in counts.values())
    fixed = np.asarray(controls.offset)[~has_weights]
    np.testing.assert_array_equal(fixed, np.asarray(controls.scene.positions)[~has_weights])


def test_the_matrix_is_the_same_map(controls):
    matrix = controls.matrix()
    assert matrix.shape == (2 * len(controls.controls), 2 * len(controls.points))
    points = np.asarray(moved_points(controls))
    product = matrix @ points.ravel() + np.asarray(controls.offset).ravel()
    np.testing.assert_allclose(
        product.reshape(-1, 2), controls.positions(jnp.asarray(points)), atol=2e-5
    )


def test_moved_points_are_written_and_read_back(controls, tmp_path):
    points = moved_points(controls)
    changed = eqx.tree_at(lambda c: c.points, controls, points)
    sr.write_svg(tmp_path / "b.svg", changed)
    read = sr.read_svg_controls(tmp_path / "b.svg")
    np.testing.assert_array_equal(read.points, points)
    # Everything else is unchanged: the other attributes, the style sheet, the comments.
    text = (tmp_path / "b.svg").read_text()
    assert "<style>.a { fill: #c33 }</style>" in text
    assert """<use href='#leaf' x="20" opacity=".5"/>""" in text
    unchanged = controls.text()
    (tmp_path / "c.svg").write_text(unchanged)
    same = sr.read_svg(tmp_path / "c.svg")
    np.testing.assert_allclose(same.positions, controls.scene.positions, atol=1e-4)
    with pytest.raises(ValueError, match="shape"):
        controls.text(points[:-1])
    with pytest.raises(ValueError, match="finite in float32"):
        controls.text(np.full(points.shape, 1e300))
    with pytest.raises(ValueError, match="not for control points"):
        sr.write_svg(tmp_path / "d.svg", controls, height=50, width=60)


def test_the_gradient_of_positions_is_the_transposed_matrix(controls):
    weights = np.random.default_rng(2).uniform(-1, 1, controls.offset.shape).astype(np.float32)
    gradient = jax.grad(lambda points: (controls.positions(points) * weights).sum())(
        controls.points
    )
    wanted = controls.matrix().T @ weights.ravel()
    assert (np.abs(wanted) > 0.01).mean() > 0.8
    np.testing.assert_allclose(np.ravel(gradient), wanted, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_the_gradient_of_an_image_by_control_points(controls, tmp_path, float64):
    """The gradient equals central differences of the exact-area image, for a drawing of fills."""
    text = DRAWING.replace(' stroke="black"', "")
    (tmp_path / "a.svg").write_text(text)
    # The drawing is moved off whole pixels: an edge on a side of a pixel has two one-sided
    # derivatives.
    shift = [[1, 0, 0.313], [0, 1, 0.271], [0, 0, 1]]
    controls = sr.read_svg_controls(tmp_path / "a.svg", transform=shift)
    controls = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float64) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf,
        controls,
    )
    plan = sr.plan(controls.scene, coverage=sr.Area(), headroom=2.0, height=50, width=60)
    weights = jnp.asarray(np.random.default_rng(1).random((50, 60, 3)))
    points = controls.points

    @jax.jit
    def loss(points):
        return (sr.render(controls.moved(points), plan) * weights).sum()

    gradient = np.asarray(jax.jit(jax.grad(loss))(points))
    assert (np.abs(gradient) > 1e-3).mean() > 0.8
    step = 1e-4
    for index in range(0, points.size, 3):
        change = np.zeros(points.size)
        change[index] = step
        change = change.reshape(points.shape)
        difference = (loss(points + change) - loss(points - change)) / (2 * step)
        np.testing.assert_allclose(gradient.ravel()[index], float(difference), rtol=1e-3, atol=1e-3)


def test_drawings_without_paths_have_no_control_points(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text('<svg width="9" height="9"><rect width="5" height="5"/><line x2="3"/></svg>')
    controls = sr.read_svg_controls(path)
    assert controls.points.shape == (0, 2)
    np.testing.assert_array_equal(controls.positions(controls.points), controls.scene.positions)
    assert controls.matrix().shape == (2 * len(controls.controls), 0)
    assert not (controls.matrix() @ np.asarray(controls.points).ravel()).any()


def test_control_points_need_an_affine_map(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text('<svg width="9" height="9"><path d="M0 0h9v9z"/></svg>')
    with pytest.raises(ValueError, match="perspective"):
        sr.read_svg_controls(path, transform=[[1, 0, 0], [0, 1, 0], [0.01, 0, 1]])
