"""The bundled scenes as small PNGs: the whole way from SVG to bytes stays as it was looked at.

After a change that is wanted, `pytest tests/test_reference_images.py --update-references` writes
them anew. A failure leaves the actual image and the difference under `tests/failures/`.
"""

from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes

REFERENCES = Path(__file__).parent / "references"
FAILURES = Path(__file__).parent / "failures"
SIZE = 300


def _draw(name: str, samples: int) -> np.ndarray:
    scene = scenes.read(name, height=SIZE, width=SIZE)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=samples))
    return np.asarray(sr.render(scene, plan))


def _levels(image: np.ndarray) -> np.ndarray:
    """Values 0..1 as the 256 levels that a PNG holds."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(int)


@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("name", scenes.names())
def test_bundled_scene(name, samples, request):
    file = f"{name}-{samples}.png"
    image = _draw(name, samples)
    if request.config.getoption("--update-references"):
        REFERENCES.mkdir(exist_ok=True)
        sr.write_image(REFERENCES / file, image)
    expected = sr.read_image(REFERENCES / file)
    assert image.shape == expected.shape
    difference = np.abs(_levels(image) - _levels(expected))
    # Another device may round the last bit, and so a tie, the other way.
    if difference.max() > 1:
        FAILURES.mkdir(exist_ok=True)
        sr.write_image(FAILURES / file, image)
        shown = np.clip(difference[..., :3] / 255 * 4, 0, 1).astype(np.float32)
        sr.write_image(FAILURES / f"{name}-{samples}-difference.png", shown)
        differing = int((difference > 1).any(axis=-1).sum())
        pytest.fail(
            f"{name} at {samples} samples differs from tests/references/{file} in {differing} "
            f"pixels, at most {difference.max()} levels; see tests/failures/."
        )


def test_no_reference_is_left_over():
    wanted = {f"{name}-{samples}.png" for name in scenes.names() for samples in (1, 16)}
    assert {path.name for path in REFERENCES.glob("*.png")} == wanted


@pytest.mark.parametrize("name", scenes.names())
def test_more_samples_change_only_edges(name):
    """One and sixteen samples agree on average: nothing is missing at either rate."""
    coarse, fine = (sr.read_image(REFERENCES / f"{name}-{samples}.png") for samples in (1, 16))
    assert abs(float(coarse.mean()) - float(fine.mean())) < 0.02
    assert float(fine.std()) > 0.01
