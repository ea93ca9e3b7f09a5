"""Fits continue correctly after a stop, after exceeding a plan, and within a time budget."""

import dataclasses
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting import budget, loop, rehearsal
from softras2d.fitting.budget import Budget, Limits
from softras2d.fitting.choices import normalize
from softras2d.fitting.interrupt import deferred_interrupt
from softras2d.fitting.layers.family import LayersFit
from softras2d.fitting.layers.sizes import FitSizes
from softras2d.fitting.mesh.family import MeshFit
from softras2d.fitting.score import Scorer
from softras2d.fitting.solvers import levenberg_marquardt
from softras2d.fitting.task import Task
from softras2d.planning.plan import Plan

from ..cases.pictures import blobs

TARGET = blobs()


def _plan_of_no_triangles(sizes: FitSizes, plan_of: Callable[..., Plan]) -> Plan:
    """The plan of an empty scene, whose lists are likely too short for the triangles of a fit."""
    empty = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)))
    return dataclasses.replace(plan_of(sizes, [empty]), lists_all=False)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["adam", "lm"])
def test_a_fit_that_exceeds_its_plan_makes_another(solver, monkeypatch):
    """The first plan is that of an empty scene."""
    plans = []
    plan_of = FitSizes.plan

    def plan_too_small(self, scenes):
        plans.append(len(scenes))
        if len(plans) > 1:
            return plan_of(self, scenes)
        return _plan_of_no_triangles(self, plan_of)

    monkeypatch.setattr(FitSizes, "plan", plan_too_small)
    result = sr.fit(TARGET, triangles=400, start="uniform", solver=solver, steps=4)
    assert len(plans) > 1
    assert result.history[-1].steps == 4
    assert np.isfinite(result.image).all()
    assert result.psnr > 10


@pytest.fixture
def plans_too_small(monkeypatch) -> list[int]:
    """Make the first two plans those of an empty scene; returns one entry for each plan made."""
    plans = []
    plan_of = FitSizes.plan

    def plan_too_small(self, scenes):
        plans.append(len(scenes))
        if len(plans) > 2:
            return plan_of(self, scenes)
        return _plan_of_no_triangles(self, plan_of)

    monkeypatch.setattr(FitSizes, "plan", plan_too_small)
    return plans


@pytest.mark.slow
def test_a_batch_that_exceeds_its_plans_makes_others(plans_too_small):
    plans = plans_too_small
    many = sr.fit_batch([TARGET, TARGET[::-1]], triangles=600, steps=6)
    assert len(plans) > 2
    for result in many:
        assert result.history[-1].steps == 6
        assert result.psnr > 10


@pytest.mark.slow
def test_a_larger_plan_holds_frozen_triangles_of_every_picture(plans_too_small):
    """The new plan has capacity for the frozen triangles of both pictures of a batch.

    Those of the second picture all lie in one tile, and those of the first are spread out.
    """
    count = 600
    rng = np.random.default_rng(0)
    triangle, colors = rng.normal(size=(count, 3, 2)), rng.random((count, 3))
    spread = rng.uniform(0, [TARGET.shape[1], TARGET.shape[0]], (count, 1, 2))
    starts = [
        sr.Scene.from_soup(centers + triangle, colors) for centers in (spread, np.array([20.0, 20]))
    ]
    many = sr.fit_batch(
        [TARGET, TARGET], triangles=count, start=starts, freeze="positions", steps=2
    )
    assert len(plans_too_small) > 2
    for result, start in zip(many, starts, strict=True):
        assert result.history[-1].steps == 2
        np.testing.assert_allclose(result.scene.positions, start.positions, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["lm", "lbfgs"])
def test_solvers_of_second_order_resume(solver):
    settings: dict[str, Any] = {"triangles": 10, "start": "uniform", "solver": solver}
    first = sr.fit(TARGET, steps=4, **settings)
    second = sr.fit(TARGET, steps=10, resume=first)
    assert second.history[-1].steps == 10
    assert second.psnr > first.psnr - 0.1


@pytest.mark.slow
def test_resuming_checks_the_target_and_uses_the_same_weights():
    left = np.zeros((40, 48))
    left[:, :24] = 1
    first = sr.fit(TARGET, triangles=6, steps=25, weights=left, seed=3)
    with pytest.raises(ValueError, match="of another `target`"):
        sr.fit(TARGET[::-1], resume=first, steps=50)
    uninterrupted = sr.fit(TARGET, triangles=6, steps=50, weights=left, seed=3)
    second = sr.fit(TARGET, resume=first, steps=50)
    assert second.psnr == pytest.approx(uninterrupted.psnr, abs=0.3)


@pytest.mark.slow
def test_a_custom_solver_must_be_given_again_to_resume():
    settings: dict[str, Any] = {"triangles": 6, "start": "uniform"}
    first = sr.fit(TARGET, solver=levenberg_marquardt(5), steps=2, **settings)
    assert first.settings["solver"] == "ByProducts"
    with pytest.raises(ValueError, match="fitted with a ByProducts: give one as"):
        sr.fit(TARGET, resume=first, steps=4)
    second = sr.fit(TARGET, resume=first, solver=levenberg_marquardt(5), steps=4)
    assert second.history[-1].steps == 4


@pytest.mark.slow
@pytest.mark.parametrize("family", [LayersFit, MeshFit])
def test_stopped_after_an_exchange_the_best_before_it_is_returned(family, monkeypatch, tmp_path):
    """An exchange of triangles raises the error at first."""
    records, exchange_of, advance = [], family._exchange, loop.advance_fits

    def exchange(self, count):
        exchange_of(self, count)
        if len(records) > 8:
            signal.raise_signal(signal.SIGINT)
            # One more step cannot lower the error to its value before the exchange.
            monkeypatch.setattr(
                loop,
                "advance_fits",
                lambda fits, steps, max_steps, devices: advance(fits, 1, max_steps, devices),
            )

    monkeypatch.setattr(family, "_exchange", exchange)
    name = "layers" if family is LayersFit else "mesh"
    result = sr.fit(
        TARGET, triangles=30, family=name, steps=500,
        report=lambda progress: records.append(progress.record.psnr),
    )  # fmt: skip
    monkeypatch.undo()
    assert result.interrupted
    assert result.history[-1].steps < 500
    assert -10 * np.log10(result.state["kept"] / TARGET.size) > max(records) - 1e-3
    if family is LayersFit:
        best = np.clip(result.state["kept.1"], 0, 1)
        np.testing.assert_array_equal(result.scene.colors, best[: len(result.scene.colors)])
    result.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=500)
    assert longer.history[-1].steps == 500


@pytest.mark.slow
def test_checkpoints_can_be_resumed(tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "_CHECKPOINT_SECONDS", 0.0)
    path = tmp_path / "fit.npz"
    sr.fit(TARGET, triangles=6, steps=50, checkpoint=path)
    checkpoint = sr.FitResult.load(path)
    assert checkpoint.interrupted
    assert sr.fit(TARGET, resume=checkpoint, steps=75).history[-1].steps == 75


@pytest.mark.slow
def test_a_second_ctrl_c_leaves_the_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "fit.npz"

    def interrupt(*_):
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        # The second Ctrl-C comes while the result is drawn.
        patch.setattr(Task, "result", interrupt)
        with pytest.raises(KeyboardInterrupt):
            sr.fit(TARGET, triangles=6, steps=500, size=24, report=interrupt, checkpoint=path)
    checkpoint = sr.FitResult.load(path)
    steps = checkpoint.history[-1].steps
    assert 0 < steps < 500
    assert checkpoint.interrupted
    # The image is from the last step. Its pixels are two pixels wide in the target.
    np.testing.assert_array_equal(checkpoint.image[::2, ::2], checkpoint.state["image"])
    assert sr.fit(TARGET, resume=checkpoint, steps=steps + 1).history[-1].steps == steps + 1


@pytest.mark.slow
def test_ctrl_c_while_the_result_is_drawn_writes_the_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "fit.npz"
    make_result = Task.result

    def interrupt_and_make_result(self, interrupted):
        signal.raise_signal(signal.SIGINT)
        return make_result(self, interrupted)

    monkeypatch.setattr(Task, "result", interrupt_and_make_result)
    result = sr.fit(TARGET, triangles=6, steps=50, checkpoint=path)
    checkpoint = sr.FitResult.load(path)
    assert result.interrupted and checkpoint.interrupted
    np.testing.assert_array_equal(checkpoint.image, result.image)


def test_a_second_ctrl_c_during_a_report_ends_the_fit_at_once(tmp_path, monkeypatch):
    def interrupt_twice(progress):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    path = tmp_path / "fit.npz"
    settings: dict[str, Any] = {"triangles": 4, "steps": 100, "report": interrupt_twice}
    with pytest.raises(KeyboardInterrupt):
        sr.fit(blobs(16, 16), checkpoint=path, **settings)
    assert sr.FitResult.load(path).interrupted
    with pytest.raises(KeyboardInterrupt):
        sr.fit_batch([blobs(16, 16)], **settings)


@pytest.mark.slow
def test_progress_tells_the_psnr_of_what_would_be_saved(monkeypatch):
    """The reported PSNR is of the hard image, at the size of the target."""
    monkeypatch.setattr(rehearsal, "_INTERVAL", 0.0)
    reports = []
    result = sr.fit(TARGET, triangles=6, steps=400, size=12, report=reports.append)
    told = np.array([report.saved_psnr for report in reports])
    known = np.isfinite(told)
    assert known[-1] and not known[0]
    scorer = Scorer(TARGET)
    drawn = [scorer.score(report.scene()).psnr for report in reports[-1:]]
    assert drawn == [result.psnr]
    assert abs(told[-1] - result.psnr) < 1.0
    assert abs(reports[-1].record.psnr - result.psnr) > 1.0


def test_a_callback_alone_has_the_saved_psnr_computed(monkeypatch):
    updates = []
    monkeypatch.setattr(rehearsal.Rehearsal, "update", lambda *_: updates.append(1))
    sr.fit(blobs(16, 16), triangles=4, steps=1, callback=lambda scene, report: None)
    assert updates


@pytest.mark.slow
def test_a_start_scene_is_drawn_at_its_position_in_the_target():
    """Positions of a start scene are in pixels of the target, even if the fit has another size."""
    first = sr.fit(TARGET, triangles=10, steps=50)
    again = sr.fit(TARGET, triangles=10, steps=0, size=24, start=first.scene)
    np.testing.assert_allclose(again.scene.positions, first.scene.positions, atol=1e-4)
    assert again.psnr == pytest.approx(first.psnr, abs=0.01)


@pytest.mark.slow
def test_unused_triangles_are_invisible_under_soft_edges():
    white = np.ones((40, 48, 3), np.float32)
    far = sr.Scene.from_soup(np.full((1, 3, 2), 20.0), np.ones((1, 3)), background=[1, 1, 1])
    result = sr.fit(white, triangles=20, start=far, softness=64, steps=1)
    assert result.history[-1].psnr > 60


@pytest.mark.slow
def test_softness_falls_to_its_last_width():
    result = sr.fit(TARGET, triangles=20, steps=100, softness=(4.0, 0.8))
    assert result.settings["softness"] == [4.0, 0.8]
    assert result.state["width"] == np.float32(0.8)
    assert result.psnr > -10 * np.log10(((TARGET - TARGET.mean((0, 1))) ** 2).mean()) + 5


def test_losses_are_those_at_the_present_softness(monkeypatch):
    measure = loop.measure

    def check_best_loss(fit):
        residual, _ = fit.residual(fit.progress.best, fit.data)
        loss = sum(float((leaf**2).sum()) for leaf in jax.tree.leaves(residual))
        assert float(fit.progress.best_loss) == pytest.approx(loss, rel=1e-4)
        return measure(fit)

    monkeypatch.setattr(loop, "measure", check_best_loss)
    sr.fit(
        blobs(16, 16), triangles=4, start="uniform", solver="bfgs", softness=(4.0, 0.8), steps=16
    )


def test_settings_become_plain_values():
    settings = {"seed": np.int64(3), "softness": np.float32(2), "shading": None, "family": "mesh"}
    plain = normalize(settings)
    assert type(plain["seed"]) is int
    assert plain == {"seed": 3, "softness": (2.0, 2.0), "shading": "gouraud", "family": "mesh"}


class TestBudget:
    """A budget of time, with a clock that the test sets."""

    @pytest.fixture
    def clock(self, monkeypatch):
        now = [100.0]
        monkeypatch.setattr(budget.time, "perf_counter", lambda: now[0])
        return now

    def budget(self, end_seconds):
        known = Future()
        if end_seconds is not None:
            known.set_result(end_seconds)
        return Budget(Limits(100.0, None, 130.0), known, 0.0)

    def test_time_for_scoring_is_reserved(self, clock):
        clock[0] = 110.0
        assert self.budget(2.0).seconds_left(0, np.nan) == 18.0
        assert self.budget(None).seconds_left(0, np.nan) == 17.0

    def test_the_share_is_one_at_the_reserved_time(self, clock):
        budget = self.budget(2.0)
        assert budget.share(0, None) == 0.0
        clock[0] = 114.0
        assert budget.share(5, 100.0) == 0.5
        clock[0] = 128.0
        assert budget.share(9, 100.0) == 1.0
        assert budget.next_steps(9, 25, 0.1, 0.0) == 1

    def test_chunks_are_short_enough_for_a_waiting_user(self, clock):
        budget = self.budget(2.0)
        assert budget.next_steps(0, 25, None, 0.0) == 1
        assert budget.next_steps(0, 25, 0.05, 0.0) == 10
        assert budget.next_steps(0, 25, 0.001, 0.0) == 25
        # Large images take long to score, and scoring may take a tenth of the time.
        assert budget.next_steps(0, 25, 0.05, 0.1) == 20
        clock[0] = 127.88
        assert budget.next_steps(0, 25, 0.05, 0.0) == 2

    def test_steps_are_as_many_as_asked(self, clock):
        budget = Budget(Limits(100.0, 30, None), Future(), 0.0)
        assert [budget.next_steps(done, 25, None, 0.0) for done in (0, 28)] == [4, 2]
        assert budget.share(15, None) == 0.5
        assert budget.seconds_left(20, 0.5) == 5.0


class TestInterrupt:
    def test_the_first_is_noted_and_the_second_raised(self):
        with deferred_interrupt() as noted:
            assert not noted.requested
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            assert noted.requested
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)

    def test_other_threads_have_none(self):
        requested = []

        def work():
            with deferred_interrupt() as noted:
                requested.append(noted.requested)

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert requested == [False]
