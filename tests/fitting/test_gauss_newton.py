"""Gauss-Newton steps of a mesh, against a slow image and finite differences of it."""

import signal
import threading

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting import chunk
from softras2d.fitting.mesh import early_program
from softras2d.fitting.mesh import gauss_newton as module
from softras2d.fitting.mesh.gauss_newton import gauss_newton, move_vertices
from softras2d.fitting.mesh.start import uniform_start
from softras2d.fitting.mesh.triangulation import check_tiling, is_bound
from softras2d.fitting.target import Target

HEIGHT, WIDTH = 13, 17


def slow_image(mesh, colors, side):
    """Image in which a pixel is the mean of `side` x `side` samples, one sample after another."""
    image = np.zeros((HEIGHT, WIDTH, 3))
    for row in range(HEIGHT * side):
        for column in range(WIDTH * side):
            point = np.array([column + 0.5, row + 0.5]) / side
            a, b, c = mesh.positions[mesh.triangles].transpose(1, 0, 2)
            matrices = np.stack([a - c, b - c], -1)
            first, second = np.linalg.solve(matrices, (point - c)[..., None])[..., 0].T
            weights = np.stack([first, second, 1 - first - second])
            triangle = weights.min(0).argmax()
            corners = colors[mesh.triangles[triangle]]
            image[row // side, column // side] += weights[:, triangle] @ corners / side**2
    return image


@pytest.fixture(params=[1, 2], ids=["one sample", "four samples"])
def problem(request, monkeypatch):
    """A mesh with colours and a target, and the number of samples along the side of a pixel."""
    side = request.param
    monkeypatch.setattr(module, "_FEW_PIXELS", 0.0 if side == 1 else np.inf)
    rng = np.random.default_rng(side)
    mesh = uniform_start(HEIGHT, WIDTH, 12, jitter=0.2, seed=1)
    weights = rng.uniform(0.5, 2.0, (HEIGHT, WIDTH)).astype(np.float32)
    target = Target(rng.random((HEIGHT, WIDTH, 3)).astype(np.float32), weights)
    return mesh, rng.uniform(0.2, 0.8, (len(mesh.positions), 3)), target, side


def jacobian(mesh, colors, target, side):
    """Derivative of the residuals, times the roots of their weights, by central differences.

    The columns of unknowns that may not change are zero.
    """
    step, columns = 1e-5, []
    roots = np.sqrt(target.weights.astype(np.float64))[..., None]
    is_fixed = np.concatenate([np.zeros((len(colors), 3), bool), is_bound(mesh)], 1)
    for vertex, unknown in np.ndindex(len(colors), 5):
        images = []
        for sign in (1, -1):
            change = np.zeros((len(colors), 5))
            change[vertex, unknown] = sign * step
            moved = mesh._replace(positions=mesh.positions + change[:, 3:])
            images.append(slow_image(moved, colors + change[:, :3], side))
        column = roots * (images[0] - images[1]) / (2 * step)
        columns.append(column.ravel() * (not is_fixed[vertex, unknown]))
    return np.stack(columns, 1)


def dense_matrix(mesh, blocks, is_fixed):
    """Assemble the blocks of all triangles, one after another; zero for fixed unknowns."""
    count = len(mesh.positions)
    matrix = np.zeros((count, 5, count, 5))
    for corners, of_triangle in zip(mesh.triangles, blocks, strict=True):
        for i, j in np.ndindex(3, 3):
            matrix[corners[i], :, corners[j]] += of_triangle[i, j]
    matrix[is_fixed] = 0.0
    matrix[:, :, is_fixed] = 0.0
    return matrix.reshape(5 * count, 5 * count)


def test_normal_equations_have_the_gradient_and_bound_the_matrix(problem):
    mesh, colors, target, side = problem
    drawing = module._draw(mesh, target, colors)
    expected = target.image - slow_image(mesh, colors, side)
    np.testing.assert_allclose(drawing.residual, expected.reshape(-1, 3).T, rtol=0, atol=1e-12)
    weights = target.weights.astype(np.float64)[..., None]
    assert drawing.error == pytest.approx((weights * expected**2).sum(), rel=1e-12)
    gradient, blocks = module._normal_equations(mesh, colors, drawing)
    is_fixed = module._layout(mesh).is_fixed
    derivative = jacobian(mesh, colors, target, side)
    product = derivative.T @ (np.sqrt(weights) * expected).ravel()
    np.testing.assert_allclose(
        np.where(is_fixed, 0, gradient).ravel(), product, rtol=0, atol=1e-5 * abs(product).max()
    )
    exact = derivative.T @ derivative
    matrix = dense_matrix(mesh, blocks, is_fixed)
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12)
    if side == 1:
        np.testing.assert_allclose(matrix, exact, rtol=0, atol=1e-4 * exact.max())
    assert np.linalg.eigvalsh(matrix - exact).min() > -1e-5 * exact.max()


def test_a_step_solves_the_damped_equations(problem, monkeypatch):
    mesh, colors, target, _ = problem
    gradient, blocks = module._normal_equations(mesh, colors, module._draw(mesh, target, colors))
    layout = module._layout(mesh)
    monkeypatch.setattr(module, "_MAX_ITERATIONS", 1000)
    monkeypatch.setattr(module, "_TOLERANCE", 1e-12)
    change = module._solve(layout, gradient, module._add_blocks(layout, blocks), 0.1)
    matrix = dense_matrix(mesh, blocks, layout.is_fixed)
    ridge = np.tile([module._COLOR_RIDGE] * 3 + [module._POSITION_RIDGE] * 2, len(colors))
    matrix += np.diag(0.1 * np.diag(matrix) + ridge)
    expected = np.linalg.solve(matrix, np.where(layout.is_fixed, 0, gradient).ravel())
    np.testing.assert_allclose(change.ravel(), expected, rtol=0, atol=1e-8 * abs(expected).max())
    assert (change[layout.is_fixed] == 0).all()


def test_steps_lower_the_error_and_keep_the_tiling(problem):
    mesh, colors, target, _ = problem
    errors = []
    for steps in range(6):
        moved, changed, _ = gauss_newton(mesh, target, colors, steps)
        check_tiling(moved)
        assert changed.min() >= 0 and changed.max() <= 1
        bound = is_bound(mesh)
        np.testing.assert_array_equal(moved.positions[bound], mesh.positions[bound])
        errors.append(module._draw(moved, target, changed).error)
    assert (np.diff(errors) <= 0).all()
    assert errors[5] < errors[1] < errors[0]


def test_a_displaced_mesh_returns(monkeypatch):
    monkeypatch.setattr(module, "_FEW_PIXELS", np.inf)
    true = uniform_start(HEIGHT, WIDTH, 12, jitter=0.2, seed=2)
    colors = np.random.default_rng(3).uniform(0.1, 0.9, (12, 3))
    target = Target(slow_image(true, colors, 2))
    rng = np.random.default_rng(4)
    offsets = np.where(is_bound(true), 0.0, rng.uniform(-0.4, 0.4, (12, 2)))
    start = true._replace(positions=true.positions + offsets)
    check_tiling(start)
    returned, returned_colors, _ = gauss_newton(start, target, np.full((12, 3), 0.5), 60)
    np.testing.assert_allclose(returned.positions, true.positions, atol=0.02)
    np.testing.assert_allclose(returned_colors, colors, atol=0.01)


def test_an_image_of_one_color_moves_nothing():
    mesh = uniform_start(HEIGHT, WIDTH, 12, jitter=0.2)
    colors = np.full((12, 3), 0.25)
    moved, changed, _ = gauss_newton(mesh, Target(np.full((HEIGHT, WIDTH, 3), 0.25)), colors, 5)
    np.testing.assert_array_equal(moved.positions, mesh.positions)
    np.testing.assert_array_equal(changed, colors)


def test_the_program_of_an_early_mesh_takes_the_steps(monkeypatch):
    """A fit waits for one program, which is compiled while the start is improved."""
    compiled, used = [], []
    advance = chunk.advance

    def early(solver, residual, *arguments, **options):
        compiled.append((residual, options))
        return advance(solver, residual, *arguments, **options)

    def late(solver, residual, *arguments, **options):
        used.append((residual, options))
        return advance(solver, residual, *arguments, **options)

    monkeypatch.setattr(early_program, "advance", early)
    monkeypatch.setattr(chunk, "advance", late)
    target = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    result = sr.fit(target, triangles=20, family="mesh", steps=3)
    assert result.history[-1].steps == 3
    ((residual, options),) = compiled
    assert options["steps"] == 0
    assert all(later is residual for later, _ in used)
    assert {later["max_steps"] for _, later in used} == {options["max_steps"]}


def test_pixels_of_weight_zero_do_not_count():
    mesh = uniform_start(HEIGHT, WIDTH, 20, jitter=0.2, seed=3)
    rng = np.random.default_rng(5)
    image = rng.random((HEIGHT, WIDTH, 3))
    weights = np.where(np.arange(WIDTH) < WIDTH // 2, 1.0, 0.0) * np.ones((HEIGHT, 1))
    colors = np.full((20, 3), 0.5)
    other = np.where(weights[..., None] > 0, image, 1 - image)
    one, two = (gauss_newton(mesh, Target(pixels, weights), colors, 4) for pixels in (image, other))
    np.testing.assert_array_equal(one.mesh.positions, two.mesh.positions)
    np.testing.assert_array_equal(one.colors, two.colors)
    nothing = gauss_newton(mesh, Target(image, 0 * weights), colors, 4)
    assert nothing.steps == 0
    np.testing.assert_array_equal(nothing.mesh.positions, mesh.positions)


def test_steps_end_when_they_must():
    mesh = uniform_start(HEIGHT, WIDTH, 20, jitter=0.2, seed=3)
    target = Target(np.random.default_rng(6).random((HEIGHT, WIDTH, 3)))
    looks = iter([False, False, True])
    assert gauss_newton(mesh, target, np.full((20, 3), 0.5), 9, lambda: next(looks)).steps == 2
    assert move_vertices(mesh, target, 9, lambda: True) is mesh


def test_the_error_of_an_early_program_is_raised(monkeypatch):
    def fail(*arguments, **options):
        raise ValueError("a mistake")

    monkeypatch.setattr(early_program, "begin", fail)
    target = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    with pytest.raises(ValueError, match="a mistake"):
        sr.fit(target, triangles=20, family="mesh", steps=3)


def test_after_ctrl_c_no_program_is_waited_for(monkeypatch):
    """The program is compiled for ever, so that waiting for it would never end."""
    begun, released = threading.Event(), threading.Event()

    def compile_for_ever(self, mesh):
        begun.set()
        released.wait()

    def press(self, mesh):
        compile_for(self, mesh)
        begun.wait()
        signal.raise_signal(signal.SIGINT)

    compile_for = early_program.EarlyProgram.compile_for
    monkeypatch.setattr(early_program.EarlyProgram, "_compile", compile_for_ever)
    monkeypatch.setattr(early_program.EarlyProgram, "compile_for", press)
    target = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    try:
        result = sr.fit(target, triangles=20, family="mesh", seconds=60)
    finally:
        released.set()
    assert result.interrupted
    assert not result.history
