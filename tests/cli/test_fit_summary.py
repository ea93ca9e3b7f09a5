"""The last line of `softras2d fit` says why triangles are missing, and which option helps."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.cli.fit_summary import shortfall, summary
from softras2d.fitting.result import Record


def result(
    triangles: int, vertices: int = 0, first_record: float = 1.0, **settings
) -> sr.FitResult:
    """A fit result with the given numbers of triangles and vertices, and the given settings."""
    scene = sr.Scene.from_soup(np.zeros((triangles, 3, 2)), np.zeros((triangles, 3)))
    if vertices:
        scene = replace(
            scene,
            positions=jnp.zeros((vertices, 2), jnp.float32),
            triangles=jnp.zeros((triangles, 3), jnp.int32),
        )
    history = (Record(1, first_record, 20.0, 0.5, 1, triangles),)
    settings = {"triangles": 500, "family": "layers", "start": "error"} | settings
    return sr.FitResult(scene, np.zeros((4, 4, 3), np.float32), 20.0, 0.5, history, settings)


@pytest.mark.parametrize(
    ("fit", "shares", "seconds", "reason"),
    [
        (result(500), [0.1], 30, None),
        (result(8), [0.1, 0.3, 0.9], 30, "more --seconds, or a smaller -n, helps"),
        (result(8), [0.1, 0.3, 1.0], None, "more --steps helps"),
        (result(8), [], 30, "more --seconds"),
        (result(8), [0.3, 0.9, 1.0], 30, "did not lower the error; a larger --size"),
        (replace(result(8), interrupted=True), [0.1], 30, "stopped before"),
        (result(8, start="uniform"), [0.1], 30, "--start error adds more"),
        (result(480, 253, family="mesh"), [], 30, "-n 520 gives about 500"),
        (result(90, 80, 11.0, family="mesh"), [], 30, "a smaller --size, adds them"),
        (result(90, 80, 10.0, family="mesh"), [], 30, "a larger --size may use them"),
    ],
)
def test_fewer_triangles_come_with_the_reason_and_the_cure(fit, shares, seconds, reason):
    given = shortfall(fit, shares, seconds)
    line = summary([], fit, elapsed=3.0, shares=shares, seconds=seconds)
    if reason is None:
        assert given is None and ": 500 triangles, PSNR" in line
    else:
        assert given is not None and reason in given
        assert f" of 500 triangles ({given}), PSNR 20.00 dB" in line
