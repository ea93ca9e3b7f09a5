"""Options that steer a fit: palettes, frozen inputs, backgrounds, custom losses, callbacks."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.mesh.start import uniform_start
from softras2d.fitting.palette import first_palette, in_palette, quantize
from softras2d.fitting.prepare import check_images
from softras2d.fitting.score import Scorer
from softras2d.fitting.target import Target

from ..cases.pictures import blobs

TARGET = blobs(32, 32)
FLAT: dict[str, Any] = {"family": "mesh", "shading": "flat"}


def colors_of(result: sr.FitResult) -> np.ndarray:
    colors = np.asarray(result.scene.colors)[..., :3].reshape(-1, 3)
    return np.unique(colors, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        pytest.param({"translucent": True}, marks=pytest.mark.slow),
        pytest.param(FLAT, marks=pytest.mark.slow),
    ],
    ids=["layers", "translucent", "mesh"],
)
def test_every_triangle_has_a_color_of_the_palette(settings, tmp_path):
    palette = np.array([[0, 0, 0], [0.9, 0.2, 0.1], [0.1, 0.3, 0.8], [0.6, 0.6, 0.5]], np.float32)
    shown = []

    def report(progress):
        shown.append(np.asarray(progress.scene().colors)[..., :3])

    result = sr.fit(TARGET, triangles=16, palette=palette, steps=48, report=report, **settings)
    allowed = set(map(tuple, palette.tolist()))
    for colors in (*shown, colors_of(result)):
        assert set(map(tuple, colors.reshape(-1, 3).tolist())) <= allowed
    assert len(colors_of(result)) > 2
    result.save(tmp_path / "fit.npz")
    loaded = sr.FitResult.load(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=loaded, steps=54)
    assert set(map(tuple, colors_of(longer).tolist())) <= allowed
    assert longer.psnr > result.psnr - 0.1


@pytest.mark.slow
def test_a_palette_found_during_a_fit_is_better_than_after_it():
    """Fitting with a palette is better than fitting freely and then replacing the colours.

    The palette that replaces the colours of the free fit is the best one for its pixels.
    """
    settings: dict[str, Any] = {"triangles": 60, "steps": 400}
    free = sr.fit(TARGET, **settings)
    palette = first_palette(Target(free.image), 4, seed=0)
    colors = in_palette(palette, free.scene.colors)
    background = in_palette(palette, free.scene.background)
    scorer = Scorer(TARGET)
    after = scorer.score(replace(free.scene, colors=colors, background=background)).psnr
    # The gain is 0.6 dB on this picture; `experiments/fit_steering` measures photographs.
    assert sr.fit(TARGET, palette=4, **settings).psnr > after + 0.4


def test_a_faint_triangle_takes_the_best_color_of_the_palette():
    """The best colour of any is (10, 0, 0), to which white is nearer than dark red."""

    class Unknowns(NamedTuple):
        colors: jax.Array

    class Data(NamedTuple):
        background: jax.Array

    def faint(y, data):
        image = jnp.full((4, 4, 4), 0.1).at[..., :3].set(y.colors[0, 0])
        return jnp.zeros(()), (image, ())

    palette = np.array([[1, 1, 1], [0.5, 0, 0]], np.float32)
    red = np.tile(np.array([1, 0, 0, 1], np.float32), (4, 4, 1))
    quantized = quantize(
        faint, Unknowns(jnp.ones((1, 1, 3))), Data(jnp.zeros(4)), Target(red), palette,
        improves_palette=False, quantizes_background=False,
    )  # fmt: skip
    np.testing.assert_array_equal(quantized.colors, [[1, 1, 1]])


def cloud() -> sr.Scene:
    rng = np.random.default_rng(3)
    corners = rng.uniform(0, 32, (6, 1, 2)) + rng.uniform(-9, 9, (6, 3, 2))
    return sr.Scene.from_soup(corners.astype(np.float32), rng.random((6, 3)).astype(np.float32))


SOME = np.array([True, False, True, False, False, True])


@pytest.mark.parametrize(
    "freeze",
    [
        pytest.param("positions", marks=pytest.mark.slow),
        pytest.param(["colors"], marks=pytest.mark.slow),
        pytest.param({"triangles": SOME}, marks=pytest.mark.slow),
    ],
    ids=["positions", "colors", "mask"],
)
def test_frozen_layers_keep_every_bit(freeze, tmp_path):
    start = cloud()
    settings: dict[str, Any] = {"triangles": 6, "start": start, "size": 27, "freeze": freeze}
    result = sr.fit(TARGET, steps=20, **settings)
    result.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=24)
    before, corners = np.asarray(start.colors), np.asarray(start.positions).reshape(-1, 3, 2)
    for fitted in (result, longer):
        same_corners = (np.asarray(fitted.scene.positions).reshape(-1, 3, 2) == corners).all((1, 2))
        same_colors = (np.asarray(fitted.scene.colors) == before).all((1, 2))
        masked = isinstance(freeze, dict)
        np.testing.assert_array_equal(same_corners, SOME if masked else freeze == "positions")
        np.testing.assert_array_equal(same_colors, SOME if masked else freeze == ["colors"])


@pytest.mark.slow
@pytest.mark.parametrize("shading", ["gouraud", "flat"])
def test_frozen_vertices_and_triangles_of_a_mesh_keep_every_bit(shading, tmp_path):
    mesh = uniform_start(32, 32, 25, jitter=0.2)
    vertices, triangles = np.zeros(25, bool), np.zeros(len(mesh.triangles), bool)
    vertices[[7, 12]] = triangles[3] = True
    settings: dict[str, Any] = {
        "triangles": 60, "family": "mesh", "shading": shading, "start": mesh,
        "freeze": {"vertices": vertices, "triangles": triangles},
    }  # fmt: skip
    before = sr.fit(TARGET, steps=0, **settings)
    after = sr.fit(TARGET, steps=20, **settings)
    after.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=24)
    kept = vertices.copy()
    kept[mesh.triangles[3]] = True
    for result in (after, longer):
        same = np.asarray(result.scene.positions) == np.asarray(before.scene.positions)
        free = mesh.free_x & mesh.free_y
        np.testing.assert_array_equal(same.all(1)[free], kept[free])
        colors = np.asarray(result.scene.colors), np.asarray(before.scene.colors)
        np.testing.assert_array_equal(colors[0][3], colors[1][3])
        assert (colors[0] != colors[1]).any()


@pytest.mark.slow
def test_added_triangles_stay_where_they_were_placed():
    scenes = []
    result = sr.fit(
        TARGET, triangles=12, freeze="positions", steps=40,
        report=lambda progress: scenes.append((progress.record.active, progress.scene())),
    )  # fmt: skip
    for active, scene in scenes:
        placed = np.asarray(scene.positions)[: 3 * active]
        np.testing.assert_array_equal(placed, np.asarray(result.scene.positions)[: 3 * active])
    assert scenes[0][0] < scenes[-1][0] == 12


REFUSED: dict[str, dict[str, Any]] = {
    "`palette` must be a number of colours from 1 to 256": {"palette": 0},
    "that many colours": {"palette": [[0, 0, 2]]},
    "got 'red'": {"palette": "red"},
    "in 0..1; got [[1000": {"palette": [[10**400, 0, 0]]},
    "it needs `shading='flat'`; got 'gouraud'": {"palette": 4, "shading": "gouraud"},
    "it needs `colors='together'`; got 'solve'": {"palette": 4, "colors": "solve"},
    "must have names from 'positions', 'colors'": {"freeze": "shapes"},
    "names, or a mapping from names; got 3": {"freeze": 3},
    "of 'triangles' needs a boolean mask": {"freeze": "triangles"},
    "of 'positions' must be True; got 1": {"freeze": {"positions": 1}},
    "of 'vertices' is for a mesh": {"freeze": {"vertices": SOME}},
    "of 'opacity' needs `translucent=True`": {"freeze": "opacity"},
    "needs a scene or mesh as `start`": {"freeze": {"triangles": SOME}},
    "must be a mask of 6 triangles, as `start` has; got 2": {
        "start": cloud(), "freeze": {"triangles": SOME[:2]},
    },
    "do not `freeze` 'colors'": {"freeze": "colors", "palette": 3},
    "`background` must be one of 'mean', 'fit', 'transparent', or a": {"background": "red"},
    "a colour [3] in 0..1; got [0.0, 2.0, 0.0]": {"background": (0, 2, 0)},
    "`background` is for layers": {"background": "fit", "family": "mesh"},
    "got 'a function': use 'adam'": {"loss": lambda image, target: 0.0, "solver": "lm"},
    "takes no `weights`": {"loss": lambda image, target: 0.0, "weights": np.ones((32, 32))},
    "one real number; its function returned float32 [32, 32, 3]": {"loss": lambda a, b: a - b},
    "'colors' needs `colors='together'`": {"freeze": "colors", "colors": "polish"},
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_invalid_steering_is_refused_in_one_line(message):
    with pytest.raises(ValueError) as caught:
        sr.fit(TARGET, **REFUSED[message])
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
def test_backgrounds_are_given_fitted_or_transparent():
    one = {"triangles": 1, "start": cloud_of_one(), "steps": 2}
    given = sr.fit(TARGET, background=[0.25, 0.5, 0.125], **one)
    np.testing.assert_array_equal(given.scene.background, [0.25, 0.5, 0.125])
    fitted = sr.fit(TARGET, background="fit", **one)
    # The one triangle lies outside the canvas, so the best background is the target's mean colour.
    np.testing.assert_allclose(fitted.scene.background, TARGET.mean((0, 1)), atol=2e-3)
    clear = sr.fit(TARGET, background="transparent", triangles=1, steps=0)
    np.testing.assert_array_equal(clear.scene.background, 0)
    assert clear.image.shape == (32, 32, 4)


def cloud_of_one() -> sr.Scene:
    corners = np.array([[[40, 40], [44, 40], [40, 44]]], np.float32)
    return sr.Scene.from_soup(corners, np.ones((1, 3)), background=[1, 1, 1])


class Perceptual(eqx.Module):
    """A loss: the squared error in features of a small network, as in the docstring of `fit`."""

    net: eqx.nn.Conv2d

    def __call__(self, image, target):
        a, b = (jax.nn.relu(self.net(x.transpose(2, 0, 1))) for x in (image, target))
        return jnp.sum((a - b) ** 2)


@pytest.mark.slow
def test_a_perceptual_loss_is_lowered(tmp_path):
    loss = Perceptual(eqx.nn.Conv2d(3, 8, 3, key=jax.random.key(0)))
    start = sr.fit(TARGET, triangles=8, start="uniform", steps=0)
    result = sr.fit(TARGET, triangles=8, start="uniform", loss=loss, steps=30)
    assert loss(result.image, TARGET) < 0.5 * loss(start.image, TARGET)
    result.save(tmp_path / "fit.npz")
    loaded = sr.FitResult.load(tmp_path / "fit.npz")
    assert loaded.settings["loss"] == "given"
    with pytest.raises(ValueError, match="function as `loss`: give it again"):
        sr.fit(TARGET, resume=loaded, steps=32)
    assert sr.fit(TARGET, resume=loaded, loss=loss, steps=32).history[-1].steps == 32


def symmetric(scene, report):
    """A callback that makes triangles mirror images of each other, as in the docstring of `fit`."""
    half = scene.triangles.shape[0] // 2 * 3
    mirrored = scene.positions[:half] * jnp.array([[-1.0, 1.0]]) + jnp.array([[32.0, 0.0]])
    return replace(scene, positions=scene.positions.at[half : 2 * half].set(mirrored))


@pytest.mark.slow
def test_a_callback_makes_a_fit_symmetric_and_may_stop_it():
    settings: dict[str, Any] = {"triangles": 6, "start": cloud(), "steps": 20}
    result = sr.fit(TARGET, callback=symmetric, **settings)
    first, second = np.split(np.asarray(result.scene.positions), 2)
    np.testing.assert_allclose(second, first * [-1, 1] + [32, 0], atol=1e-4)
    assert np.abs(first - np.asarray(cloud().positions)[:9]).max() > 0.1

    def fail(scene, report):
        raise RuntimeError(f"after {report.record.steps} steps")

    with pytest.raises(RuntimeError, match="after 3 steps"):
        sr.fit(TARGET, callback=fail, **settings)
    wrong = {
        "a scene or None; got 3": lambda scene, report: 3,
        "finite `positions`": lambda scene, report: cloud_of_one(),
    }
    for message, callback in wrong.items():
        with pytest.raises(ValueError, match=message):
            sr.fit(TARGET, callback=callback, **settings)


@pytest.mark.slow
def test_a_callback_of_a_mesh_moves_vertices_as_far_as_no_triangle_flips():
    def gather(scene, report):
        return replace(scene, positions=scene.positions.at[:].set(16.0))

    result = sr.fit(TARGET, triangles=24, family="mesh", start="uniform", steps=8, callback=gather)
    corners = np.asarray(result.scene.positions)[np.asarray(result.scene.triangles)]
    ab, ac = (corners[:, k] - corners[:, 0] for k in (1, 2))
    areas = (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) / 2
    assert (areas > 0).all() and areas.sum() == pytest.approx(32 * 32, rel=1e-5)


@pytest.mark.slow
def test_a_callback_does_not_move_frozen_vertices_of_a_mesh():
    def shift(scene, report):
        return replace(scene, positions=scene.positions + 1.0)

    height, width = TARGET.shape[:2]
    start = uniform_start(height, width, 15, jitter=0.2)
    frozen = np.arange(15) % 2 == 0
    result = sr.fit(
        TARGET, triangles=24, family="mesh", start=start, steps=8, callback=shift,
        freeze={"vertices": frozen},
    )  # fmt: skip
    moved = result.state["mesh.positions"]
    np.testing.assert_allclose(moved[frozen], start.positions[frozen], atol=1e-5)
    assert (abs(moved - start.positions)[~frozen] > 0.1).any()


def test_targets_of_other_types_become_images():
    bytes_of = np.round(TARGET * 255).astype(np.uint8)
    gray, mask = bytes_of[..., 0], TARGET[..., 0] > 0.5
    images = check_images([bytes_of, gray, gray[..., None], mask])
    np.testing.assert_allclose(images[0], TARGET, atol=0.5 / 255 + 1e-6)
    np.testing.assert_array_equal(images[1], images[2])
    np.testing.assert_array_equal(images[1], np.repeat(images[0][..., :1], 3, axis=2))
    np.testing.assert_array_equal(images[3], np.repeat(mask[..., None], 3, axis=2))
    assert all(image.dtype == np.float32 for image in images)


def test_colors_above_one_are_fitted_as_one_and_said_to_be():
    bright = TARGET.copy()
    bright[:8, :, 1] = 7.5
    with pytest.warns(UserWarning, match=r"above 1 in 25\.0% of its pixels"):
        (image,) = check_images([bright])
    np.testing.assert_array_equal(image, np.minimum(bright, 1))
    for wrong in (-TARGET, np.full((4, 4, 4), 2.0), np.full((4, 4, 3), np.inf)):
        with pytest.raises(ValueError, match=r"`target` must hold numbers in 0\.\.1"):
            check_images([wrong])
    with pytest.raises(ValueError, match="got int64"):
        check_images([np.zeros((4, 4, 3), np.int64)])
