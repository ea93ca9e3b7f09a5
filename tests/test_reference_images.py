"""Small images of the bundled scenes, from SVG to PNG, equal references that were checked by eye.

After an intended change, `pytest tests/test_reference_images.py -m "slow or not slow" -k bundled
--update-references` writes them anew. A failure leaves the image and its difference in
`tests/references/failures/`.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes

from .cases.marks import slowly
from .oracles.coverage import Canvas, draw

REFERENCES = Path(__file__).parent / "references"
SIZE = 300
SHADED = ("minified", "zone_plate", "stretched", "magnified", "ground", "overlap", "crossing")
"""Scenes with textures, depth or perspective."""

BOTH_RATES = pytest.mark.parametrize("samples", [slowly(1), 16])


def _read(name: str) -> sr.Scene:
    return scenes.read(name, height=SIZE, width=SIZE)


def _plan(scene: sr.Scene | list[sr.Scene], samples: int) -> sr.Plan:
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=samples))


def _is_plain(scene: sr.Scene) -> bool:
    """Whether a scene has neither textures nor depth nor perspective."""
    return scene.textures is None and scene.depth is None and scene.inverse_w is None


def _in_one_structure(drawn: dict[str, sr.Scene]) -> dict[str, sr.Scene]:
    """The scenes with equal arrays, corner colours and alpha, so as to share a program."""
    most = max(scene.triangles.shape[0] for scene in drawn.values())
    padded = {}
    for name, scene in drawn.items():
        scene_colors = np.asarray(scene.colors)
        # Triangles that are added have all corners at one point off the canvas.
        corners = np.full((most, 3, 2), -1, np.float32)
        colors = np.ones((most, 3, 4), np.float32)
        corners[: len(scene_colors)] = np.asarray(scene.positions)[np.asarray(scene.triangles)]
        colors[: len(scene_colors), :, : scene_colors.shape[-1]] = scene_colors
        padded[name] = sr.Scene.from_soup(corners, colors, background=scene.background)
    return padded


def _file(name: str, samples: int) -> Path:
    return REFERENCES / f"{name}-{samples}.png"


@BOTH_RATES
def test_bundled_scenes_in_one_structure_equal_their_references(samples, assert_image_matches):
    read = {name: _read(name) for name in scenes.names()}
    drawn = _in_one_structure({name: scene for name, scene in read.items() if _is_plain(scene)})
    plan = _plan(list(drawn.values()), samples)
    for name, scene in drawn.items():
        assert_image_matches(sr.render(scene, plan), _file(name, samples))


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 16])
def test_bundled_scenes_without_effects_equal_the_oracle(samples):
    """Scenes of one structure share a program."""
    read = {name: _read(name) for name in scenes.names()}
    alike = defaultdict(list)
    for scene in filter(_is_plain, read.values()):
        alike[np.shape(scene.colors)[1:]].append(scene)
    for group in alike.values():
        plan = _plan(group, samples)
        for scene in group:
            image = np.asarray(sr.render(sr.pad(scene), plan))
            corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
            on = Canvas(SIZE, SIZE, round(samples**0.5))
            expected = draw(corners, scene.colors, scene.background, on)
            np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("name", SHADED)
def test_a_bundled_scene_with_effects_equals_its_reference(name, samples, assert_image_matches):
    """There is no oracle for these scenes here; other tests compare the effects with oracles."""
    scene = _read(name)
    assert_image_matches(sr.render(scene, _plan(scene, samples)), _file(name, samples))


def test_every_reference_belongs_to_a_scene():
    wanted = {f"{name}-{samples}.png" for name in scenes.names() for samples in (1, 16)}
    assert {path.name for path in REFERENCES.glob("*.png")} == wanted


@pytest.mark.parametrize("name", scenes.names())
def test_references_are_not_empty_and_agree_at_both_rates(name):
    """References are not constant, and their means are close at one sample and at sixteen."""
    coarse, fine = (sr.read_image(_file(name, samples)) for samples in (1, 16))
    assert float(fine.std()) > 0.01
    assert abs(float(coarse.mean()) - float(fine.mean())) < 0.02
