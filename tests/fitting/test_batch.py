"""Fits of several images by one program are as good as single fits.

Each image may have its own start and weights.
"""

import re
import signal
import time
from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr

from ..cases.pictures import blobs, mean_psnr

TARGET = blobs()


@pytest.mark.slow
def test_a_batch_fits_as_well_as_each_target_alone():
    targets = [TARGET, TARGET[::-1, ::-1]]
    reports = []
    results = sr.fit_batch(targets, triangles=10, steps=50, seed=4, report=reports.append)
    assert [records[1] for records in reports] == list(results[1].history)
    for k, (target, result) in enumerate(zip(targets, results, strict=True)):
        alone = sr.fit(target, triangles=10, steps=50, seed=4 + k)
        assert result.psnr == pytest.approx(alone.psnr, abs=0.3)
        assert result.history[-1].steps == 50
        assert result.psnr > mean_psnr(target) + 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"targets": [TARGET, TARGET[1:]]}, "images of one shape"),
        ({"targets": []}, "images of one shape"),
        ({"start": ["uniform"]}, "`start` must be one for each of 2 targets; got 1"),
        ({"start": np.array("error")}, "`start` must be one for each of 2 targets; got array("),
        (
            {"start": "here"},
            "`start` must be 'error', 'uniform', 'delaunay' or a Scene; got 'here'",
        ),
        ({"weights": np.ones((3, 40, 48))}, "`weights` must be one for each of 2 targets; got 3"),
        ({"weights": np.ones(48)}, "`weights` must be numbers"),
        ({"seconds": -1.0}, "`seconds` must be a number above 0"),
        ({"seconds": 1, "steps": 1}, "give one of"),
        ({"resume": []}, "`resume` must be one for each of 2 targets; got 0"),
        ({"weights": [None, np.ones((40, 48))]}, "for every target or for none"),
    ],
)
def test_invalid_batches_are_refused(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        sr.fit_batch(**{"targets": [TARGET, TARGET], **arguments})


@pytest.mark.slow
def test_a_batch_takes_a_start_and_weights_for_each_and_resumes():
    targets = [TARGET, TARGET[::-1, ::-1]]
    left = np.zeros((40, 48))
    left[:, :24] = 1
    scene = sr.fit(targets[1], triangles=10, steps=25).scene
    settings: dict[str, Any] = {"triangles": 10, "start": ["delaunay", scene], "colors": "polish"}
    first_fits = sr.fit_batch(targets, weights=np.stack([left, 1 - left]), steps=25, **settings)
    for k, (target, result) in enumerate(zip(targets, first_fits, strict=True)):
        side = np.s_[:, :24] if k == 0 else np.s_[:, 24:]
        other = np.s_[:, 24:] if k == 0 else np.s_[:, :24]
        error = (result.image - target) ** 2
        assert error[side].mean() < error[other].mean()
    longer_fits = sr.fit_batch(targets, steps=50, resume=first_fits)
    for k, (target, first, result) in enumerate(zip(targets, first_fits, longer_fits, strict=True)):
        assert result.history[: len(first.history)] == first.history
        assert result.history[-1].steps == 50
        alone = sr.fit(target, steps=50, resume=first)
        assert result.psnr == pytest.approx(alone.psnr, abs=0.3), k
    with pytest.raises(ValueError, match="fits with the same settings"):
        sr.fit_batch(targets, resume=[longer_fits[0], sr.fit(targets[1], triangles=3, steps=1)])
    with pytest.raises(ValueError, match="fits with equal numbers of steps"):
        sr.fit_batch(targets, resume=[first_fits[0], longer_fits[1]])
    with pytest.raises(ValueError, match="is of 48 x 40 pixels"):
        sr.fit_batch([image[:20] for image in targets], resume=longer_fits)
    mesh = sr.fit(TARGET, triangles=10, family="mesh", steps=1)
    with pytest.raises(ValueError, match="fits of layers; got those of a mesh"):
        sr.fit_batch([TARGET, TARGET], resume=[mesh, mesh])


@pytest.mark.slow
def test_a_batch_for_seconds_ends():
    began = time.perf_counter()
    results = sr.fit_batch([TARGET, TARGET[::-1]], triangles=10, seconds=8.0)
    assert all(result.history[-1].steps >= 1 for result in results)
    # The bound is loose because a machine may be busy.
    assert time.perf_counter() - began < 60
    np.testing.assert_array_equal(
        [record.steps for record in results[0].history],
        [record.steps for record in results[1].history],
    )


@pytest.mark.slow
def test_scores_of_a_batch_share_a_program(count_compilations):
    """All scores of a batch share a program, so the time for scoring includes no compilation."""
    jax.clear_caches()
    with count_compilations() as compiled:
        sr.fit_batch([TARGET, TARGET[::-1], TARGET[:, ::-1]], triangles=10, steps=10)
    drawn = [name for name in compiled.names if "render" in name]
    assert 1 <= len(drawn) <= 2, compiled.names


@pytest.mark.slow
def test_ctrl_c_ends_a_batch():
    def press(records):
        signal.raise_signal(signal.SIGINT)

    results = sr.fit_batch([TARGET, TARGET], triangles=4, steps=500, report=press)
    assert all(result.interrupted and len(result.history) == 1 for result in results)
    longer = sr.fit(TARGET, resume=results[0], steps=results[0].history[0].steps + 5)
    assert longer.history[-1].steps == results[0].history[0].steps + 5
