"""Names and bounds in the script of the page are those of Python."""

import dataclasses
import json
import re
from typing import Any, get_args

import pytest

from softras2d.names import CoverageKind, FillRule, LevelFilter, PixelFilter, Shading
from softras2d.options import Filter, Hard
from softras2d.viewing.packed_pixels import BLOCK
from softras2d.viewing.server import STATIC
from softras2d.viewing.settings import LOD_BIASES, SOFT_WIDTHS, Settings
from softras2d.viewing.view import MAX_CANVAS_PIXELS, MAX_CANVAS_SIDE, MAX_ENLARGED_SIDE, MAX_OFFSET

SCRIPT = (STATIC / "viewer.js").read_text()


def constant(name: str) -> Any:
    """The value of a constant of the script: a number, or a list or an object of literals."""
    match = re.search(rf"^const {name} = ([^;]*);", SCRIPT, re.MULTILINE)
    assert match is not None, f"viewer.js has no constant {name}"
    power = re.fullmatch(r"(\d+) \*\* (\d+)", match[1])
    if power is not None:
        return int(power[1]) ** int(power[2])
    with_quoted_keys = re.sub(r"(\w+):", r'"\1":', match[1])
    return json.loads(re.sub(r",\s*}", "}", with_quoted_keys))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("COVERAGES", list(get_args(CoverageKind))),
        ("FILL_RULES", list(get_args(FillRule))),
        ("SHADINGS", list(get_args(Shading))),
        ("PIXEL_FILTERS", list(get_args(PixelFilter))),
        ("LEVEL_FILTERS", list(get_args(LevelFilter))),
        ("SOFT_WIDTHS", list(SOFT_WIDTHS)),
        ("LOD_BIASES", list(LOD_BIASES)),
        ("MAX_DRAWING_SIDE", MAX_ENLARGED_SIDE),
        ("MAX_OFFSET", MAX_OFFSET),
        ("MAX_CANVAS_SIDE", MAX_CANVAS_SIDE),
        ("MAX_CANVAS_PIXELS", MAX_CANVAS_PIXELS),
        ("BLOCK", BLOCK),
        ("DEFAULT_SETTINGS", dataclasses.asdict(Settings())),
    ],
)
def test_the_script_has_the_value_of_python(name, expected):
    assert constant(name) == expected


def test_python_accepts_the_choices_of_the_script():
    for samples in constant("SAMPLES"):
        Hard(samples=samples)
    for anisotropy in constant("ANISOTROPIES"):
        Filter(anisotropy=anisotropy)
