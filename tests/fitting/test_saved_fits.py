"""Fits that an earlier version saved can be loaded, drawn and resumed.

The files contain fits of 12 triangles to a target of 24 x 24 pixels, stopped after 10 of 40 steps:

    def report(moment):
        if moment.record.steps >= 10:
            raise KeyboardInterrupt

    sr.fit(blobs(24, 24), triangles=12, family=family, steps=40, report=report)
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.prepare import settings_to_resume

from ..cases.pictures import blobs

SAVED = Path(__file__).parent / "saved"

TARGET = blobs(24, 24)

FAMILIES = ("layers", "mesh")


@pytest.mark.parametrize("family", FAMILIES)
def test_a_fit_of_an_earlier_version_loads(family):
    result = sr.FitResult.load(SAVED / f"{family}.npz")
    assert result.settings["family"] == family
    assert result.interrupted
    assert [record.steps for record in result.history] == [5, 10]
    plan = sr.plan(result.scene, height=24, width=24, coverage=sr.Hard(samples=16))
    np.testing.assert_allclose(sr.render(result.scene, plan), result.image, atol=1e-6)


def test_a_large_mesh_of_an_earlier_version_is_resumed_at_its_size():
    """Earlier versions fitted a mesh at the size of its target unless a size was given."""
    result = sr.FitResult.load(SAVED / "mesh.npz")
    assert result.settings["size"] is None
    large = dataclasses.replace(result, image=np.zeros((3, 1030, 3)))
    assert settings_to_resume(result.settings, large)["size"] == 1030


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_fit_of_an_earlier_version_can_be_resumed(family):
    result = sr.FitResult.load(SAVED / f"{family}.npz")
    longer = sr.fit(TARGET, resume=result, steps=40)
    assert not longer.interrupted
    assert longer.history[: len(result.history)] == result.history
    assert longer.history[-1].steps == 40
    assert longer.psnr > result.psnr
