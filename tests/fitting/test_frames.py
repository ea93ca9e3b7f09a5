"""Fits of films: triangles persist from frame to frame, and a temporal weight lowers flicker."""

import signal

import numpy as np
import pytest

import softras2d as sr
from softras2d.comparison.flicker import flicker

from ..cases.pictures import blobs


def film(frames: int) -> list[np.ndarray]:
    """Frames in which a box moves over a still picture with faint noise."""
    rng = np.random.default_rng(0)
    images = []
    for k in range(frames):
        image = blobs() + rng.normal(0, 0.3 / 255, (40, 48, 3)).astype(np.float32)
        image[28:36, 2 + 3 * k : 10 + 3 * k] = [1.0, 0.9, 0.0]
        images.append(np.clip(image, 0, 1))
    return images


@pytest.mark.slow
def test_a_temporal_weight_lowers_flicker_and_triangles_keep_their_identity():
    frames = film(5)
    films = {}
    for temporal in (0.0, 2.0):
        seen = []
        results = sr.fit_frames(
            frames, triangles=30, steps=150, frame_steps=30, temporal=temporal,
            report=lambda number, result, seen=seen: seen.append((number, result)),
        )  # fmt: skip
        assert seen == list(enumerate(results)) and len(results) == 5
        films[temporal] = results
        colors = np.stack([np.asarray(result.scene.colors) for result in results])
        steps = np.abs(np.diff(colors, axis=0)).max((2, 3))
        others = np.abs(colors[1:, :, None] - colors[:-1, None]).max((3, 4))
        # The colour of a triangle is closer to the colour of the same triangle in the next frame
        # than to those of nearly all other triangles there.
        assert (steps[:, :, None] <= others).mean() > 0.95
        assert min(result.psnr for result in results) > 20
    still, free = (flicker([r.image for r in films[t]], frames) for t in (2.0, 0.0))
    assert 0 < still < 0.7 * free
    # The temporal weight does not affect the first frame.
    np.testing.assert_array_equal(films[0.0][0].image, films[2.0][0].image)


@pytest.mark.slow
def test_ctrl_c_during_the_report_of_a_frame_ends_the_film_there():
    def interrupt(number, result):
        if number == 1:
            signal.raise_signal(signal.SIGINT)

    results = sr.fit_frames(film(4), triangles=5, steps=10, frame_steps=2, report=interrupt)
    assert [result.interrupted for result in results] == [False, True]


def test_flicker_is_the_change_where_the_target_stands_still():
    targets = [np.zeros((2, 2, 3)), np.zeros((2, 2, 3))]
    targets[1][0] = 0.5
    images = [np.zeros((2, 2, 3)), np.zeros((2, 2, 3))]
    images[1][0], images[1][1, 0] = 0.7, 0.1
    assert flicker(images, targets) == pytest.approx(0.05)
    assert np.isnan(flicker(images[:1], targets[:1]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"images": [blobs(), blobs(8, 8)]}, "`images` must be frames of one shape"),
        ({"frame_steps": 0}, "`frame_steps` must be an integer of 1 or more; got 0"),
        ({"temporal": -1.0}, "`temporal` must be a number from 0 on; got -1.0"),
        ({"temporal": float("nan")}, "`temporal` must be a number from 0 on; got nan"),
        ({"triangles": 0}, "`triangles` must be an integer in 1..2147483647; got 0"),
        ({"shading": "linear"}, "`shading` of a layers fit"),
    ],
)
def test_errors(change, message):
    arguments = {"images": [blobs(), blobs()]} | change
    with pytest.raises(ValueError, match=message):
        sr.fit_frames(**arguments)
