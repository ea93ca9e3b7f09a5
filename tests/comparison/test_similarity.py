"""PSNR and SSIM, in NumPy and in JAX, agree with their definitions."""

import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.comparison.similarity import psnr, ssim


def ssim_by_hand(a, b) -> float:
    """SSIM from its definition, one Gaussian window of 11 x 11 pixels at a time, in float64."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = np.outer(taps, taps) / taps.sum() ** 2
    values = []
    for y in range(a.shape[0] - 10):
        for x in range(a.shape[1] - 10):
            for channel in range(a.shape[2]):
                p, q = (i[y : y + 11, x : x + 11, channel].astype(np.float64) for i in (a, b))
                p_mean, q_mean = (window * p).sum(), (window * q).sum()
                p_variance = (window * (p - p_mean) ** 2).sum()
                q_variance = (window * (q - q_mean) ** 2).sum()
                covariance = (window * (p - p_mean) * (q - q_mean)).sum()
                numerator = (2 * p_mean * q_mean + 1e-4) * (2 * covariance + 9e-4)
                values.append(
                    numerator / ((p_mean**2 + q_mean**2 + 1e-4) * (p_variance + q_variance + 9e-4))
                )
    return float(np.mean(values))


@pytest.mark.parametrize(("xp", "tolerance"), [(jnp, 1e-5), (np, 1e-6)])
def test_ssim_equals_a_loop(xp, tolerance):
    rng = np.random.default_rng(0)
    a = rng.random((14, 17, 2)).astype(np.float32)
    b = np.clip(a + 0.2 * rng.normal(size=a.shape), 0, 1).astype(np.float32)
    assert float(ssim(xp.asarray(a), xp.asarray(b))) == pytest.approx(
        ssim_by_hand(a, b), abs=tolerance
    )


@pytest.mark.parametrize("xp", [np, jnp])
@pytest.mark.parametrize("shape", [(1, 1, 3), (4, 30, 3), (20, 20, 3)])
def test_equal_images_score_highest(shape, xp):
    image = xp.asarray(np.random.default_rng(1).random(shape), np.float32)
    assert float(ssim(image, image)) == pytest.approx(1.0, abs=1e-5)
    assert np.isinf(psnr(image, image))


@pytest.mark.parametrize("xp", [np, jnp])
def test_psnr_of_a_known_error(xp):
    zero = xp.zeros((3, 4, 3), np.float32)
    assert float(psnr(zero, zero + 0.1)) == pytest.approx(20.0, abs=1e-4)
