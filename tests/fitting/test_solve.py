"""Solvers that advance in chunks find the known answers of small problems."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from softras2d.fitting.solve import (
    advance,
    advance_each,
    begin,
    forget_best,
    move,
    set_learning_rate,
)
from softras2d.fitting.solvers import SOLVERS, levenberg_marquardt, solver_of

ANSWER = np.array([0.3, -1.2, 0.8, 2.0], np.float32)
RNG = np.random.default_rng(0)
MATRIX = RNG.normal(size=(9, 4)).astype(np.float32)


def residual(y, args):
    """The residual of a nonlinear least-squares problem, scaled by `args`; 0 at the answer."""
    error = y - ANSWER
    return args * (MATRIX @ (error + 0.1 * error**3)), (error, jnp.sum(y))


STEPS = {"adam": 600, "lm": 12, "dogleg": 20, "bfgs": 60, "lbfgs": 60}


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_finds_the_answer_in_chunks(name):
    solver = solver_of(name, learning_rate=0.05)
    progress = begin(solver, residual, jnp.zeros(4), jnp.float32(1.0))
    assert np.isinf(progress.best_loss)
    losses = []
    for _ in range(4):
        progress, chunk_losses, (error, sums) = advance(
            solver, residual, progress, jnp.float32(1.0), steps=STEPS[name] // 4
        )
        losses += chunk_losses.tolist()
        assert sums.shape == chunk_losses.shape
        assert error.shape == (4,)
    assert progress.steps == STEPS[name]
    assert losses[-1] < 1e-3 * losses[0]
    np.testing.assert_allclose(progress.best, ANSWER, atol=2e-2)
    assert float(progress.best_loss) == pytest.approx(min(losses), rel=1e-6)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solve_continues_from_where_it_is_moved_to(name):
    solver, scale = solver_of(name, learning_rate=0.05), jnp.float32(1.0)
    progress = begin(solver, residual, jnp.zeros(4), scale)
    progress, before, _ = advance(solver, residual, progress, scale, steps=3)
    far = jnp.full(4, 3.0)
    progress = move(solver, residual, progress, far, scale)
    assert progress.steps == 3
    progress, losses, _ = advance(solver, residual, progress, scale, steps=1)
    assert losses[0] == pytest.approx(float((residual(far, scale)[0] ** 2).sum()), rel=1e-5)
    # The best loss is still from before the move.
    assert float(progress.best_loss) == pytest.approx(min(before.tolist()), rel=1e-6)


def test_chunks_give_the_result_of_one_run():
    solver = levenberg_marquardt(products=3)
    start = begin(solver, residual, jnp.zeros(4), jnp.float32(1.0))
    at_once, _, _ = advance(solver, residual, start, jnp.float32(1.0), steps=6)
    in_chunks = start
    for _ in range(3):
        in_chunks, _, _ = advance(solver, residual, in_chunks, jnp.float32(1.0), steps=2)
    np.testing.assert_allclose(at_once.y, in_chunks.y, atol=1e-6)


def test_other_arguments_compile_nothing(count_compilations):
    solver = solver_of("adam", learning_rate=0.05)
    progress = begin(solver, residual, jnp.zeros(4), jnp.float32(1.0))
    progress, _, _ = advance(solver, residual, progress, jnp.float32(1.0), steps=5)
    with count_compilations() as compiled:
        advance(solver, residual, progress, jnp.float32(2.0), steps=5)
    assert not compiled.names


def test_the_best_is_returned_if_the_solver_diverges():
    def residual_with_nan(y, args):
        return jnp.where(y[0] > 0.5, jnp.nan, (y[0] - 1.0) ** 2), (None, None)

    solver = solver_of("adam", learning_rate=0.2)
    progress = begin(solver, residual_with_nan, jnp.zeros(1), None)
    progress, losses, _ = advance(solver, residual_with_nan, progress, None, steps=12)
    assert np.isnan(losses[-1])
    assert np.isfinite(progress.best).all()
    assert np.isfinite(progress.best_loss)


def test_a_changed_loss_starts_a_new_best():
    solver = solver_of("adam", learning_rate=0.05)
    progress = begin(solver, residual, jnp.zeros(4), jnp.float32(0.1))
    progress, _, _ = advance(solver, residual, progress, jnp.float32(0.1), steps=5)
    progress = forget_best(progress)
    progress, losses, _ = advance(solver, residual, progress, jnp.float32(1.0), steps=5)
    assert float(progress.best_loss) == pytest.approx(float(losses.min()), rel=1e-6)


def test_any_solver_of_optimistix_is_taken():
    solver = optx.GaussNewton(rtol=0.0, atol=0.0)
    assert solver_of(solver) is solver
    progress = begin(solver, residual, jnp.zeros(4), jnp.float32(1.0))
    progress, _, _ = advance(solver, residual, progress, jnp.float32(1.0), steps=12)
    np.testing.assert_allclose(progress.best, ANSWER, atol=1e-2)


def test_an_unknown_solver_is_named():
    with pytest.raises(ValueError, match="`solver` must be an optimistix solver or one of 'adam'"):
        solver_of("newton")


@pytest.mark.slow
def test_a_batch_of_solves_equals_each_alone():
    for name in ("adam", "lm"):
        solver = solver_of(name, learning_rate=0.05)
        scales = [jnp.float32(1.0), jnp.float32(3.0)]
        starts = [jnp.zeros(4), jnp.ones(4)]
        many = [begin(solver, residual, y, s) for y, s in zip(starts, scales, strict=True)]
        results = advance_each(solver, residual, many, scales, steps=4)
        for start, scale, result in zip(many, scales, results, strict=True):
            alone = advance(solver, residual, start, scale, steps=4)
            np.testing.assert_allclose(result[0].y, alone[0].y, atol=1e-5)
            np.testing.assert_allclose(result[1], alone[1], rtol=1e-4)
            assert result[0].steps == 4
            assert np.isfinite(result[0].best_loss)


def test_a_rate_can_be_set_without_compiling(count_compilations):
    solver = solver_of("adam", learning_rate=0.05)
    scale = jnp.float32(1.0)
    progress = begin(solver, residual, jnp.zeros(4), scale)
    progress, _, _ = advance(solver, residual, progress, scale, steps=2)
    at_rate_zero = set_learning_rate(progress, 0.0)
    with count_compilations() as compiled:
        after, _, _ = advance(solver, residual, at_rate_zero, scale, steps=2)
    assert not compiled.names
    np.testing.assert_array_equal(after.y, progress.y)
    other = begin(solver_of("bfgs"), residual, jnp.zeros(4), scale)
    assert set_learning_rate(other, 0.1) is other
