"""Every measure of `compare` equals a short formula, for images with and without alpha.

Also its table, its picture of the differences, and its errors.
"""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from .test_similarity import ssim_by_hand

RNG = np.random.default_rng(0)
EXPECTED = (RNG.integers(0, 256, (14, 17, 3)) / 255).astype(np.float32)


def changed(*changes: tuple[int, int, int, float]) -> np.ndarray:
    """A copy of `EXPECTED` with some values (row, column, channel, value) set."""
    image = EXPECTED.copy()
    for row, column, channel, value in changes:
        image[row, column, channel] = value
    return image


def test_measures_equal_their_formulas():
    actual = np.clip(EXPECTED + 0.1 * RNG.normal(size=EXPECTED.shape), 0, 1).astype(np.float32)
    comparison = sr.compare(actual, EXPECTED, tolerance=0.1)
    errors = actual.astype(np.float64) - EXPECTED
    largest = np.abs(errors).max(-1)
    assert comparison.max_difference == largest.max()
    assert comparison.mean_difference == pytest.approx(np.abs(errors).mean())
    assert comparison.rmse == pytest.approx(np.sqrt((errors**2).mean()))
    assert comparison.psnr == pytest.approx(-20 * np.log10(comparison.rmse))
    assert comparison.ssim == pytest.approx(ssim_by_hand(actual, EXPECTED), abs=1e-9)
    assert comparison.differing_pixels == (largest > 0.1).sum() > 0
    assert comparison.differing_share == comparison.differing_pixels / (14 * 17)
    assert not comparison.matches
    np.testing.assert_array_equal(comparison.difference, largest)
    worst = sorted((-largest[i, j], i, j) for i in range(14) for j in range(17))[:5]
    assert [(-d, i, j) for d, i, j in worst] == [
        (pixel.difference, pixel.row, pixel.column) for pixel in comparison.worst_pixels
    ]


def test_equal_images_have_no_worst_pixel():
    comparison = sr.compare(jnp.asarray(EXPECTED), EXPECTED, tolerance=0)
    assert comparison.matches and comparison.worst_pixels == ()
    assert comparison.max_difference == comparison.rmse == comparison.differing_share == 0
    assert comparison.psnr == np.inf and comparison.ssim == pytest.approx(1)
    assert "PSNR                infinite" in str(comparison)


def test_one_level_is_within_the_default_tolerance_at_every_level():
    """Adjacent 8-bit levels differ by 1 / 255 up to a rounding of float32, up or down."""
    levels = (np.arange(256) / 255).astype(np.float32).reshape(1, 256, 1)
    assert sr.compare(levels[:, 1:], levels[:, :-1]).matches
    assert sr.compare(levels[:, 2:], levels[:, :-2]).differing_pixels == 254
    assert sr.compare(levels[:, 1:], levels[:, :-1], tolerance=0).differing_pixels == 255


def test_opaque_alpha_and_grey_change_no_measure():
    actual = changed((3, 4, 0, 0.5))
    opaque = np.dstack([actual, np.ones((14, 17, 1), np.float32)])
    plain = sr.compare(actual, EXPECTED)
    assert str(sr.compare(opaque, EXPECTED)) == str(plain)
    assert str(sr.compare(opaque, np.dstack([EXPECTED, opaque[..., 3:]]))) == str(plain)
    grey = EXPECTED[..., :1]
    assert sr.compare(grey, grey.repeat(3, -1), tolerance=0).matches


def test_transparent_images_are_compared_premultiplied():
    alpha = np.ones((14, 17, 1), np.float32)
    alpha[2, 3], alpha[5, 6] = 0.0, 0.5
    clear = np.dstack([EXPECTED, alpha])
    other = clear.copy()
    other[2, 3, :3] = 1 - other[2, 3, :3]
    assert sr.compare(other, clear, tolerance=0).matches  # The colour of this pixel is invisible.
    other[5, 6, 1] += 0.25
    assert sr.compare(other, clear).worst_pixels == (pytest.approx((5, 6, 0.125)),)
    against_rgb = sr.compare(clear, EXPECTED)
    assert [pixel[:2] for pixel in against_rgb.worst_pixels] == [(2, 3), (5, 6)]
    assert against_rgb.max_difference == 1.0
    assert against_rgb.mean_difference == pytest.approx(
        (1 + EXPECTED[2, 3].sum() + 0.5 * (1 + EXPECTED[5, 6].sum())) / (14 * 17 * 4)
    )


def test_flip_is_that_of_the_evaluator():
    evaluator = pytest.importorskip("flip_evaluator")
    actual = changed((3, 4, 0, 1.0), (8, 9, 1, 0.0))
    comparison = sr.compare(actual, EXPECTED)
    mean = evaluator.evaluate(EXPECTED, actual, "LDR", applyMagma=False)[1]
    assert comparison.flip == pytest.approx(mean) and mean > 0
    black, white = np.zeros((1, 1, 4), np.float32), np.ones((1, 1, 3), np.float32)
    assert sr.compare(black, white).flip == 0  # Transparent, over white.


def test_without_the_evaluator_the_table_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    comparison = sr.compare(EXPECTED, EXPECTED)
    assert comparison.flip is None
    assert 'FLIP                not measured; pip install "softras2d[compare]"' in str(comparison)


def test_the_table_is_short_and_has_units():
    lines = str(sr.compare(changed((3, 4, 0, EXPECTED[3, 4, 0] / 2)), EXPECTED)).splitlines()
    assert lines[0] == (
        "pixels that differ  1 of 238 (0.42 %), by more than 0.003922 (1 of 255 levels)"
    )
    assert lines[1].endswith("of 255 levels)") and lines[4].endswith(" dB")
    assert lines[-1].startswith("worst pixels        row 3, column 4: 0.")
    assert len(lines) == 8 and max(map(len, lines)) < 100


def test_the_picture_shows_differing_pixels_in_colour_over_dark_grey():
    picture = sr.compare(changed((3, 4, 0, EXPECTED[3, 4, 0] + 0.02)), EXPECTED).picture
    others = np.delete(picture.reshape(-1, 3), 3 * 17 + 4, axis=0)
    assert picture[3, 4, 0] > 0.75 > 0.3 > others.max()
    assert (others == others[:, :1]).all()
    full = sr.compare(np.ones((1, 1, 3)), np.zeros((1, 1, 3))).picture
    np.testing.assert_array_equal(full, np.ones((1, 1, 3)))


@pytest.mark.parametrize(
    ("actual", "message"),
    [
        (EXPECTED[1:], "same height and width; got height 13, width 17 and height 14, width 17"),
        (changed((2, 3, 1, np.nan)), "`actual`: row 2, column 3, channel 1 is nan"),
        (EXPECTED[..., 0], "`actual`: an image is"),
        ((EXPECTED * 255).astype(np.uint8), "`actual`: an image holds floats, 0..1; got uint8"),
    ],
)
def test_errors_are_one_line(actual, message):
    with pytest.raises(ValueError) as error:
        sr.compare(actual, EXPECTED)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("tolerance", [-0.1, np.nan, np.inf])
def test_a_tolerance_is_finite_and_not_negative(tolerance):
    with pytest.raises(ValueError, match="`tolerance` must be finite and at least 0; got"):
        sr.compare(EXPECTED, EXPECTED, tolerance=tolerance)
