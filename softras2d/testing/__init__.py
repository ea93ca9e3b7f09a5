"""Helps to test renderers: an assertion that compares an image with a reference image on disk.

    from softras2d.testing import assert_image_matches

    assert_image_matches(image, "references/teapot.png")

`softras2d.testing.plugin` offers the same assertion as a pytest fixture, with the option
`--update-references`; only that module needs pytest.
"""

from .references import assert_image_matches

__all__ = ["assert_image_matches"]
