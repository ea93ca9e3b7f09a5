"""The CPU and an accelerator draw the same bits; these tests are skipped without an accelerator."""

import jax
import numpy as np
import pytest

import softras2d as sr

from .cases.scenes import COUNT, assert_same_counts, canvas, cases, colors_of, vast
from .oracles.coverage import draw

pytestmark = pytest.mark.skipif(
    jax.default_backend() == "cpu", reason="no accelerator to compare with"
)

BLACK = np.zeros(3, np.float32)


def _images_of_both(scene: sr.Scene, plan: sr.Plan) -> tuple[np.ndarray, np.ndarray]:
    """The images that the accelerator and the CPU draw."""
    images = []
    for device in (jax.devices()[0], jax.devices("cpu")[0]):
        image, overflow = sr.render_checked(*jax.device_put((scene, plan), device))
        assert not bool(overflow)
        images.append(np.asarray(image))
    return images[0], images[1]


@pytest.mark.parametrize("fill_rule", ["inclusive", "top_left"])
@pytest.mark.parametrize("rate", [1, 2, 3, 4, 8, 16])
def test_coverage_is_the_same(rate, fill_rule):
    on = canvas(rate, fill_rule)
    colors = colors_of(COUNT)
    drawn = {n: sr.Scene.from_soup(c, colors, background=BLACK) for n, c in cases(on).items()}
    largest = [sr.Scene.from_soup(c, colors, background=BLACK) for c in vast(on, COUNT)]
    hard = sr.Hard(samples=on.samples, fill_rule=fill_rule)
    plan = sr.plan([*largest, *drawn.values()], height=on.height, width=on.width, coverage=hard)
    for name, scene in drawn.items():
        on_accelerator, on_cpu = _images_of_both(scene, plan)
        np.testing.assert_array_equal(on_accelerator, on_cpu, err_msg=name)
        assert_same_counts(on_accelerator, draw(cases(on)[name], colors, BLACK, on), on.samples)


@pytest.mark.parametrize("size", [50, 1e4, 1e8])
def test_triangles_past_the_band_are_cut_the_same(size):
    on = canvas(4)
    corners = np.random.default_rng(0).normal(size=(COUNT, 3, 2)) * size + [14, 10]
    scene = sr.Scene.from_soup(corners.astype(np.float32), colors_of(COUNT), background=BLACK)
    plan = sr.plan(scene, height=on.height, width=on.width, coverage=sr.Hard(samples=16))
    on_accelerator, on_cpu = _images_of_both(scene, plan)
    np.testing.assert_array_equal(on_accelerator, on_cpu)


@pytest.mark.parametrize("background", [3, 4])
@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("corners", [1, 3])
def test_colors_are_close(corners, channels, background):
    on = canvas(4)
    colors = colors_of(COUNT, channels, corners)
    back = np.array([0.25, 0.5, 1.0, 0.5], np.float32)[:background]
    for name, points in cases(on).items():
        scene = sr.Scene.from_soup(points, colors, background=back)
        plan = sr.plan(scene, height=on.height, width=on.width, coverage=sr.Hard())
        on_accelerator, on_cpu = _images_of_both(scene, plan)
        np.testing.assert_allclose(on_accelerator, on_cpu, rtol=0, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(
            on_accelerator, draw(points, colors, back, on), rtol=0, atol=2e-6
        )
