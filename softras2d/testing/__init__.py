"""Tests of renderers: assertions that compare an image with a reference on disk.

    from softras2d.testing import assert_image_matches

    assert_image_matches(image, "references/teapot.png")

`softras2d.testing.plugin` makes it a pytest fixture with the option `--update-references`; pytest
is needed for that module alone.
"""

from .references import assert_image_matches

__all__ = ["assert_image_matches"]
