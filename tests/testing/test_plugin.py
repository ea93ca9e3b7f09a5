"""The pytest plugin writes and compares references in the test suite of a user."""

import sys

import pytest

import softras2d as sr

pytest_plugins = "pytester"

SUITE = """
import numpy as np

def test_picture(assert_image_matches):
    assert_image_matches(np.full((4, 5, 3), {value}), "references/grey.png")
"""


@pytest.fixture
def suite(pytester, monkeypatch):
    """Write a test whose image is a grey value, and run it with some options."""
    # Otherwise Python could run the cached bytecode of a file that was changed within a second.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    pytester.makeconftest('pytest_plugins = ["softras2d.testing.plugin"]')
    folder = pytester.mkdir("rendering")

    def run(value: float, *options: str) -> pytest.RunResult:
        (folder / "test_suite.py").write_text(SUITE.format(value=value))
        return pytester.runpytest_inprocess("-p", "no:xdist", "-p", "no:hypothesispytest", *options)

    return run


def test_a_reference_is_missing_then_written_then_matched_then_missed(suite, pytester):
    missing = suite(0.25)
    missing.assert_outcomes(failed=1)
    missing.stdout.fnmatch_lines(["*rendering/references/grey.png: there is no such reference; *"])
    suite(0.25, "--update-references").assert_outcomes(passed=1)
    reference = pytester.path / "rendering" / "references" / "grey.png"
    assert sr.read_image(reference).shape == (4, 5, 3)
    suite(0.25).assert_outcomes(passed=1)
    missed = suite(0.75)
    missed.assert_outcomes(failed=1)
    missed.stdout.fnmatch_lines(["E * the image differs from its reference.", "E * 20 of 20 *"])
    assert (reference.parent / "failures" / "grey-difference.png").is_file()
    suite(0.75, "--update-references").assert_outcomes(passed=1)
    suite(0.75).assert_outcomes(passed=1)
