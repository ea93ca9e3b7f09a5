"""`fit` lowers the error, stops and resumes, gives no NaN, and refuses bad arguments."""

import itertools
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.mesh.triangulation import check_tiling, delaunay_mesh
from softras2d.fitting.prepare import check_images

from ..cases.pictures import blobs, mean_psnr

TARGET = blobs()


@pytest.mark.parametrize(
    ("family", "shading"),
    [
        ("layers", "flat"),
        pytest.param("layers", "gouraud", marks=pytest.mark.slow),
        pytest.param("mesh", "gouraud", marks=pytest.mark.slow),
    ],
)
def test_a_fit_lowers_the_error_and_reports_it(family, shading):
    moments = []
    result = sr.fit(
        TARGET, triangles=24, family=family, shading=shading, steps=125, report=moments.append
    )
    assert result.psnr > mean_psnr(TARGET) + 6
    assert (result.height, result.width) == TARGET.shape[:2]
    assert result.scene.triangles.shape[0] <= 24
    assert result.history[-1].steps == 125
    assert len(moments) == len(result.history) == 8
    assert moments[-1].share == 1
    assert not result.interrupted
    # Rendering the scene gives the image that was scored.
    plan = sr.plan(result.scene, height=40, width=48, coverage=sr.Hard(16))
    np.testing.assert_allclose(sr.render(result.scene, plan), result.image, atol=1e-6)
    assert result.psnr == pytest.approx(-10 * np.log10(np.mean((result.image - TARGET) ** 2)), 1e-4)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result():
    one, two = (sr.fit(TARGET, triangles=12, steps=50, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.scene.positions, two.scene.positions)
    np.testing.assert_array_equal(one.image, two.image)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["layers", "mesh"])
def test_an_interrupted_fit_resumes_to_the_uninterrupted_result(family, tmp_path):
    def interrupt(progress):
        if progress.record.steps >= 50:
            raise KeyboardInterrupt

    settings: dict[str, Any] = {"triangles": 14, "family": family, "seed": 1}
    uninterrupted = sr.fit(TARGET, steps=100, **settings)
    first = sr.fit(TARGET, steps=100, report=interrupt, **settings)
    assert first.interrupted
    # The fit ends with the chunk that contains step 50. Both fits have the same chunks.
    chunk_ends = [record.steps for record in first.history]
    assert chunk_ends == [record.steps for record in uninterrupted.history][: len(chunk_ends)]
    assert chunk_ends[-2] < 50 <= chunk_ends[-1]
    assert np.isfinite(first.image).all()
    first.save(tmp_path / "fit.npz")
    second = sr.fit(TARGET, steps=100, resume=sr.FitResult.load(tmp_path / "fit.npz"))
    assert not second.interrupted
    assert second.history[-1].steps == 100
    np.testing.assert_allclose(second.scene.positions, uninterrupted.scene.positions, atol=1e-3)
    assert second.psnr == pytest.approx(uninterrupted.psnr, abs=1e-3)
    assert second.settings == first.settings


@pytest.mark.slow
def test_a_fitted_mesh_tiles_the_canvas():
    result = sr.fit(TARGET, triangles=40, family="mesh", steps=50)
    scene = result.scene
    area = np.asarray(scene.positions)[np.asarray(scene.triangles)].astype(np.float64)
    ab, ac = area[:, 1] - area[:, 0], area[:, 2] - area[:, 0]
    double = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    assert (double > 0).all()
    assert double.sum() / 2 == pytest.approx(40 * 48, rel=1e-6)


@pytest.mark.slow
def test_a_fit_for_seconds_ends():
    began = time.perf_counter()
    result = sr.fit(TARGET, triangles=12, seconds=12.0)
    assert result.history
    # The bound is loose because a machine may be busy; `experiments/fit_kodak` measures time.
    assert time.perf_counter() - began < 60


def known_scene(number: int, seed: int) -> tuple[sr.Scene, np.ndarray, sr.Scene]:
    """A scene, its image under soft coverage, and a start: the scene with its corners moved."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([14, 14], [50, 50], (number, 1, 2))
    angle = rng.uniform(0, 6.28, (number, 1)) + np.array([0, 2.09, 4.19])
    radius = rng.uniform(11, 16, (number, 1, 1))
    corners = middle + radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    colors = rng.uniform(0.1, 0.9, (number, 3))
    background = np.array([0.5, 0.5, 0.5])
    scene = sr.Scene.from_soup(corners.astype(np.float32), colors, background=background)
    moved = corners + rng.uniform(-5, 5, corners.shape) / 2**0.5
    start = sr.Scene.from_soup(moved.astype(np.float32), colors, background=background)
    plan = sr.plan(scene, height=64, width=64, coverage=sr.Soft(0.8))
    return scene, np.asarray(sr.render(scene, plan)), start


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_levenberg_marquardt_recovers_a_known_scene(seed):
    scene, image, start = known_scene(3, seed)
    result = sr.fit(
        np.clip(image, 0, 1), triangles=3, solver="lm", steps=30, start=start, softness=0.8
    )
    error = np.abs(np.asarray(result.scene.positions) - np.asarray(scene.positions))
    assert error.max() < 0.05


NOISE = np.random.default_rng(0).random((24, 24, 3)).astype(np.float32)
EXTREME_TARGETS = {
    "one-pixel": NOISE[:1, :1],
    "row": NOISE[:1],
    "constant": np.full((24, 24, 3), 0.25, np.float32),
    "black": np.zeros((24, 24, 3), np.float32),
    "noise": NOISE,
}
POINTS = {
    "one-point": np.full((8, 3, 2), 12.0),
    "off-canvas": np.full((8, 3, 2), -500.0) + np.eye(3, 2) * 9,
    "slivers": np.stack([np.array([[0, i], [24, i + 1e-4], [12, i]]) for i in range(8)]),
    "huge": 1e5 * np.array([[-1, -1], [1, -1], [0, 1]]) * np.ones((8, 1, 1)),
    "on-centres": np.array([[0.5, 0.5], [8.5, 0.5], [0.5, 8.5]]) * np.ones((8, 1, 1)),
}


OF_SEVERAL_ROWS = ("constant", "black", "noise")
"""Extreme targets of one size, whose fits share programs."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver, target",
    [
        *itertools.product(["adam", "lm"], OF_SEVERAL_ROWS),
        *itertools.product(["dogleg", "bfgs", "lbfgs"], ["noise"]),
        *itertools.product(["adam", "lm"], ["one-pixel", "row"]),
    ],
)
def test_extreme_starts_give_no_nan(solver, target):
    """Every target is fitted from every start that its size allows, in about 50 fits."""
    image = EXTREME_TARGETS[target]
    starts = POINTS.values() if image.shape[:2] == (24, 24) else [None]
    for corners in starts:
        start = "uniform"
        if corners is not None:
            start = sr.Scene.from_soup(corners.astype(np.float32), np.full((8, 3), 0.5))
        assert_sound(sr.fit(image, triangles=8, solver=solver, steps=4, start=start))


def assert_sound(result):
    assert np.isfinite(result.image).all()
    assert np.isfinite(np.asarray(result.scene.positions)).all()
    assert np.isfinite(np.asarray(result.scene.colors)).all()
    assert not np.isnan(result.psnr)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["one-pixel", *OF_SEVERAL_ROWS])
def test_extreme_targets_are_fitted_to_the_end(target):
    """Fits of translucent layers under SSIM, and of meshes, run until triangles are exchanged."""
    image = EXTREME_TARGETS[target]
    variants: list[dict[str, Any]] = [{"translucent": True, "loss": "ssim"}, {"family": "mesh"}]
    for settings in variants:
        assert_sound(sr.fit(image, triangles=8, steps=30, **settings))


@pytest.mark.slow
@pytest.mark.parametrize("loss, light", [("l1", "linear"), ("ssim", "display")])
def test_fits_under_other_losses_lower_the_error(loss, light):
    result = sr.fit(TARGET, triangles=12, steps=75, loss=loss, light=light)
    assert result.psnr > mean_psnr(TARGET) + 3


@pytest.mark.slow
def test_a_target_with_alpha_is_fitted_in_alpha_too():
    alpha = np.zeros((40, 48, 1), np.float32)
    alpha[8:30, 10:36] = 1
    target = np.concatenate([TARGET, alpha], -1)
    result = sr.fit(target, triangles=16, steps=100)
    assert result.image.shape == target.shape
    # The PSNR reported during the fit is close to the final score.
    assert result.history[-1].psnr == pytest.approx(result.psnr, abs=1.5)
    # The error would be 0.3 if all pixels were transparent, and 0.7 if all were opaque.
    assert np.mean((result.image[..., 3] - alpha[..., 0]) ** 2) < 0.05


@pytest.mark.slow
def test_fits_with_other_colors_lower_the_error():
    variants: list[dict[str, Any]] = [
        {"translucent": True},
        {"colors": "solve"},
        {"colors": "polish"},
    ]
    for settings in variants:
        result = sr.fit(TARGET, triangles=12, steps=75, **settings)
        assert result.psnr > mean_psnr(TARGET) + 5


@pytest.mark.slow
def test_the_error_is_lower_where_weights_are_large():
    left = np.zeros((40, 48))
    left[:, :24] = 1
    errors = []
    for weights in (left, left[:, ::-1]):
        result = sr.fit(TARGET, triangles=6, steps=75, weights=weights)
        error = ((result.image - TARGET) ** 2).mean(-1)
        errors.append((error[:, :24].mean(), error[:, 24:].mean()))
    (left_where_large, right_where_zero), (left_where_zero, right_where_large) = errors
    assert left_where_large < left_where_zero
    assert right_where_large < right_where_zero


@pytest.mark.slow
@pytest.mark.parametrize("shading", ["flat", "linear"])
def test_meshes_with_other_shading_lower_the_error(shading):
    result = sr.fit(TARGET, triangles=40, family="mesh", shading=shading, steps=50)
    assert result.psnr > mean_psnr(TARGET) + 6


def mesh_of_corners(height, width):
    points = [[0, 0], [width, 0], [0, height], [width, height], [height / 2, height / 2]]
    mesh = delaunay_mesh(np.array(points, float), height=height, width=width)
    check_tiling(mesh)
    return mesh


@pytest.mark.slow
def test_a_mesh_may_start_anywhere():
    for start in (mesh_of_corners(40, 48), "uniform"):
        result = sr.fit(TARGET, triangles=12, family="mesh", steps=25, start=start)
        assert result.psnr > mean_psnr(TARGET)


TWO_TRIANGLES = sr.Scene.from_soup(np.arange(12.0).reshape(2, 3, 2) ** 2 / 8, np.full((2, 3), 0.5))
WITH_DEPTH = replace(TWO_TRIANGLES, depth=jnp.zeros(6))

REFUSED: dict[str, dict[str, Any]] = {
    "`target` must be \\[height": dict(target=np.zeros((4, 4, 2), np.float32)),
    "`target` must hold numbers in 0..1": dict(target=np.full((4, 4, 3), np.nan, np.float32)),
    "`family` must be one of 'layers', 'mesh'": dict(family="sphere"),
    "`shading` of a layers fit": dict(shading="linear"),
    "`solver` must be": dict(solver="newton"),
    "`triangles` must be an integer in 1..2147483647": dict(triangles=0),
    "`steps` must be": dict(steps=-1),
    "give one of `steps` and `seconds`": dict(steps=1, seconds=1.0),
    "`seconds` must be": dict(seconds=-1.0),
    "`softness` must be": dict(softness=0),
    "got np.timedelta64": dict(softness=np.timedelta64(5, "ns")),
    "`softness` must be pixels": dict(softness=(1, 2, 3)),
    "`colors` must be one of": dict(colors="guess"),
    "`loss` must be one of": dict(loss="huber"),
    "solvers of least squares": dict(solver="lm", loss="l1"),
    "`weights` must be numbers": dict(weights=np.ones((3, 3))),
    "`weights` must be finite": dict(weights=np.zeros((40, 48))),
    "`start` must be 'error'": dict(start="middle"),
    "`start` has 2 triangles; `triangles` is 1": dict(start=TWO_TRIANGLES, triangles=1),
    "it has depth": dict(start=WITH_DEPTH),
    "`start` is a mesh of 20 x 20 pixels; the fit has 48 x 40": dict(
        family="mesh", start=mesh_of_corners(20, 20)
    ),
    "`start` is a mesh with a position that is not finite": dict(
        family="mesh",
        start=mesh_of_corners(40, 48)._replace(positions=np.full((5, 2), np.inf)),
    ),
    "`start` has 5 vertices; `triangles` allows 4": dict(
        family="mesh", start=mesh_of_corners(40, 48), triangles=2
    ),
    "translucent triangles": dict(start=replace(TWO_TRIANGLES, colors=jnp.full((2, 1, 4), 0.5))),
    "suffix of a checkpoint must be .npz": dict(checkpoint="fit.ckpt"),
    "no folder": dict(checkpoint="nowhere/fit.npz"),
    "`translucent` is for layers": dict(family="mesh", translucent=True),
    "fit targets with alpha by layers": dict(
        target=np.full((4, 4, 4), 0.5, np.float32), family="mesh"
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_invalid_arguments_are_refused_in_one_line(message):
    with pytest.raises(ValueError, match=message) as caught:
        arguments: dict[str, Any] = {"target": TARGET} | REFUSED[message]
        sr.fit(**arguments)
    assert "\n" not in str(caught.value)


def test_an_alpha_of_one_everywhere_is_dropped():
    """Screenshots often have such an alpha channel."""
    opaque = np.concatenate([TARGET, np.ones_like(TARGET[..., :1])], -1)
    (alone,) = check_images([opaque])
    np.testing.assert_array_equal(alone, TARGET)
    half = opaque * np.float32(0.5)
    assert [image.shape[-1] for image in check_images([opaque, half])] == [4, 4]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["adam", "lm"])
def test_a_fit_is_in_float32_also_under_x64(solver, float64):
    with jax.enable_x64(True):
        result = sr.fit(TARGET, triangles=8, steps=4, solver=solver, colors="polish")
    assert result.scene.positions.dtype == np.float32
    assert result.scene.triangles.shape[0] == 8


@pytest.mark.slow
def test_a_saved_fit_loads_exactly(tmp_path):
    result = sr.fit(TARGET, triangles=8, steps=25)
    result.save(tmp_path / "fit.npz")
    loaded = sr.FitResult.load(tmp_path / "fit.npz")
    assert loaded.history == result.history
    assert loaded.settings == result.settings
    assert (loaded.psnr, loaded.ssim) == (result.psnr, result.ssim)
    for name in ("positions", "triangles", "colors", "background"):
        np.testing.assert_array_equal(getattr(loaded.scene, name), getattr(result.scene, name))
    np.testing.assert_array_equal(loaded.image, result.image)
    assert loaded.state.keys() == result.state.keys()
    report = result.report()
    assert report["settings"]["seed"] == 0
    assert report["versions"]["jax"]
    (tmp_path / "bad.npz").write_bytes(b"PK nothing")
    with pytest.raises(ValueError, match=r"not a complete \.npz file"):
        sr.FitResult.load(tmp_path / "bad.npz")
    with pytest.raises(ValueError, match="no such file"):
        sr.FitResult.load(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="`resume` is of 48 x 40"):
        sr.fit(TARGET[:20], resume=replace(loaded, history=()))


def test_a_fit_without_steps_is_valid():
    result = sr.fit(TARGET, triangles=8, steps=0)
    assert result.history == ()
    assert np.isfinite(result.psnr)
    assert jnp.isfinite(result.scene.positions).all()


@pytest.mark.slow
def test_layers_start_from_a_delaunay_mesh():
    """The start is a tiling in least-squares colours, which already resembles the image."""
    settings: dict[str, Any] = {"triangles": 60, "shading": "gouraud", "start": "delaunay"}
    result = sr.fit(TARGET, steps=0, **settings)
    assert 40 < result.scene.triangles.shape[0] <= 60
    assert result.psnr > mean_psnr(TARGET) + 4
    moved = sr.fit(TARGET, steps=50, **settings)
    assert moved.psnr > result.psnr + 1


@pytest.mark.slow
def test_a_mesh_starts_from_a_delaunay_mesh():
    even = sr.fit(TARGET, triangles=60, family="mesh", start="delaunay", steps=0)
    moved = sr.fit(TARGET, triangles=60, family="mesh", start="delaunay", steps=50)
    assert moved.psnr > even.psnr + 1


@pytest.mark.slow
def test_far_corners_of_a_start_are_not_moved_to_the_canvas(tmp_path):
    far = [[[-900.0, 20.0], [900.0, -300.0], [900.0, 340.0]]]
    scene = sr.Scene.from_soup(far, [[0.2, 0.4, 0.6]], background=[0.5, 0.5, 0.5])
    result = sr.fit(TARGET, triangles=3, start=scene, steps=0)
    np.testing.assert_allclose(result.scene.positions, scene.positions, rtol=1e-6)
    moved = sr.fit(TARGET, triangles=3, start=scene, steps=5)
    assert np.abs(np.asarray(moved.scene.positions) - scene.positions).max() < 10
    moved.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=8)
    assert np.abs(np.asarray(longer.scene.positions) - scene.positions).max() < 10
    with pytest.raises(ValueError, match="of `start` must be finite"):
        sr.fit(TARGET, start=replace(scene, positions=scene.positions * np.nan), steps=0)
