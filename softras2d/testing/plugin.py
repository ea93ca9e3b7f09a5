"""A pytest plugin: the fixture `assert_image_matches`, and the option `--update-references`.

To use it, write this line into the `conftest.py` at the root of the tests:

    pytest_plugins = ["softras2d.testing.plugin"]
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--update-references` to pytest, which calls this function."""
    parser.getgroup("softras2d").addoption(
        "--update-references",
        action="store_true",
        help="Write the references of assert_image_matches from the images of this run, instead "
        "of comparing with them.",
    )


@pytest.fixture
def assert_image_matches(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Provide `softras2d.testing.assert_image_matches` as a fixture, without its argument `update`.

    The fixture updates the reference if the option `--update-references` is given. A relative path
    starts at the folder of the test file.
    """
    # Imported here, so that a run of other tests does not wait for NumPy and OpenImageIO to load.
    from . import references

    update = bool(request.config.getoption("--update-references"))
    folder = request.path.parent

    def check(image: Any, path: str | Path, **options: Any) -> None:
        __tracebackhide__ = True
        references.assert_image_matches(image, folder / path, update=update, **options)

    return check
