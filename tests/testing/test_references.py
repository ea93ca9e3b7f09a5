"""`assert_image_matches` writes references, accepts equal images, and reports all others."""

import subprocess
import sys

import numpy as np
import pytest

import softras2d as sr
from softras2d.testing import assert_image_matches

IMAGE = np.random.default_rng(0).random((12, 13, 3)).astype(np.float32)


@pytest.fixture
def reference(tmp_path):
    """The path of a reference for `IMAGE`, in a folder that `update` makes."""
    path = tmp_path / "references" / "a.png"
    assert_image_matches(IMAGE, path, update=True)
    return path


def test_an_image_matches_the_reference_it_has_written(reference):
    assert_image_matches(IMAGE, reference, tolerance=0)
    assert_image_matches(IMAGE + 1 / 256, str(reference))
    opaque = np.dstack([IMAGE, np.ones((12, 13, 1), np.float32)])
    assert_image_matches(opaque, reference, tolerance=0)
    assert [path.name for path in reference.parent.iterdir()] == ["a.png"]


def test_a_failure_saves_the_image_and_its_difference(reference):
    wrong = IMAGE.copy()
    wrong[3, 4] = 1 - IMAGE[3, 4]
    with pytest.raises(AssertionError) as error:
        assert_image_matches(wrong, reference)
    first, *_, reference_line, image_line, difference_line = str(error.value).splitlines()
    assert first == "the image differs from its reference."
    assert "1 of 156" in str(error.value) and "row 3, column 4" in str(error.value)
    failures = reference.parent / "failures"
    assert reference_line.split() == ["reference", str(reference)]
    assert image_line.split() == ["image", str(failures / "a.png")]
    assert difference_line.split() == ["difference", str(failures / "a-difference.png")]
    assert_image_matches(wrong, failures / "a.png", tolerance=0)
    picture = sr.read_image(failures / "a-difference.png")
    assert picture[3, 4].max() > 0.7 > 0.3 > picture[5].max()


def test_a_missing_reference_is_one_line(tmp_path):
    with pytest.raises(AssertionError) as error:
        assert_image_matches(IMAGE, tmp_path / "a.png")
    assert str(error.value) == (
        f"{tmp_path / 'a.png'}: there is no such reference; "
        "`pytest --update-references` writes it (or `update=True`)."
    )
    assert list(tmp_path.iterdir()) == []


def test_another_size_is_one_line_and_the_image_is_saved(reference):
    with pytest.raises(AssertionError) as error:
        assert_image_matches(IMAGE[:-1], reference)
    saved = reference.parent / "failures" / "a.png"
    assert str(error.value) == (
        f"the image has height 11 and width 13, but {reference} has height 12 and width 13; "
        f"the image: {saved}"
    )
    assert sr.read_image(saved).shape == (11, 13, 3)


@pytest.mark.parametrize("update", [False, True])
def test_what_is_not_an_image_is_refused_and_the_reference_kept(reference, update):
    before = reference.read_bytes()
    with pytest.raises(ValueError, match="`image`: row 0, column 0, channel 0 is nan"):
        assert_image_matches(np.full((12, 13, 3), np.nan), reference, update=update)
    with pytest.raises(ValueError, match=r"a\.jpg: a reference must be a \.png file"):
        assert_image_matches(IMAGE, reference.with_suffix(".jpg"), update=update)
    with pytest.raises(ValueError, match="`tolerance` must be finite"):
        assert_image_matches(IMAGE, reference, tolerance=float("nan"), update=update)
    assert reference.read_bytes() == before


def test_neither_pytest_nor_jax_is_imported(tmp_path):
    code = """
import sys, numpy
from softras2d.testing import assert_image_matches
assert_image_matches(numpy.ones((2, 2, 3)), sys.argv[1], update=True)
assert_image_matches(numpy.ones((2, 2, 3)), sys.argv[1])
assert not {"pytest", "jax"} & set(sys.modules)
"""
    command = [sys.executable, "-c", code, str(tmp_path / "ones.png")]
    subprocess.run(command, check=True, timeout=60)
