"""Small files made to take hours are read, or refused in one line, within seconds.

An algorithm of quadratic time would take hours here, so an alarm ends a test that takes too long.
"""

import base64
import os
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.io.budget import MAX_TEXELS, Budget, BudgetError
from softras2d.io.images import decode_image, read_image
from softras2d.io.svg.reading.reader import read_svg
from softras2d.io.svg.xml import assets

from ..cases.hostile import ends_within, grey_png, outcome, polygon
from ..cases.marks import slowly

DATA = os.environ.get("SOFTRAS2D_DATA", "")


def test_an_image_that_would_fill_the_memory_is_refused(tmp_path):
    data = grey_png(16384, 16384, b"short")
    (tmp_path / "bomb.png").write_bytes(data)
    for read in (
        lambda: read_image(tmp_path / "bomb.png"),
        lambda: decode_image(data, "bomb.png"),
    ):
        with (
            ends_within(15),
            pytest.raises(ValueError, match=r"bomb\.png: 16384 x .* at most 1 GiB"),
        ):
            read()
    uri = "data:image/png;base64," + base64.b64encode(data).decode()
    message = outcome(f'<svg><image width="9" height="9" href="{uri}"/></svg>')
    assert "<image> embedded image: 16384 x 16384 pixels" in str(message)


def test_images_of_a_document_share_a_limit(tmp_path):
    (tmp_path / "first.png").write_bytes(grey_png(1024, 4096))
    # The second is damaged, and must be refused before it is decoded.
    (tmp_path / "second.png").write_bytes(grey_png(1024, 4096, b"damaged"))
    budget = Budget()
    budget.charge("texels", MAX_TEXELS - 2**22)
    pictures = assets.Assets(tmp_path, None, True, budget)
    assert pictures.picture("first.png").shape == (1024, 4096, 3)
    with pytest.raises(BudgetError, match="pixels of pictures; at most 67,108,864"):
        pictures.picture("second.png")


def test_a_course_image_is_refused_before_it_becomes_triangles(tmp_path):
    noise = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    sr.write_image(tmp_path / "noise.png", noise)
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg width="4096" height="4096"><image width="4096" height="4096" href="noise.png"/></svg>'
    )
    with ends_within(30), pytest.raises(ValueError, match=r"a\.svg:1: <image> .*2,097,152"):
        read_svg(path, dialect="course", height=4096, width=4096)


def drawing(attribute):
    return f'<svg width="9" height="9"><rect {attribute} width="5" height="5"/></svg>'


MADE_HERE = {
    "polygon.svg": f'<svg width="9" height="9">{polygon(np.ones((20_000, 2)))}</svg>',
    "colour.svg": drawing('fill="lab(1e308 1e308 1e308)"'),
    "length.svg": drawing(f'x="{"1" * 5000}{" " * 5000}!"'),
    "style.svg": drawing(f'style="fill:{"(" * 1000}"'),
    "bomb.png": grey_png(16384, 16384),
}


@pytest.fixture(scope="module", params=["own", slowly("data")])
def folder(request, tmp_path_factory):
    """A folder of files: made here, or the folder `hostile` in SOFTRAS2D_DATA."""
    if request.param == "data":
        if not DATA:
            pytest.skip("SOFTRAS2D_DATA is not set")
        return Path(DATA) / "hostile"
    folder = tmp_path_factory.mktemp("hostile")
    for name, content in MADE_HERE.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def test_every_hostile_file_is_read_or_refused_in_one_line(folder):
    for path in sorted(folder.iterdir()):
        if path.suffix == ".svg":
            reads = [
                partial(read_svg, path, dialect=dialect, height=60, width=80)
                for dialect in ("svg", "course")
            ]
        elif path.suffix in (".png", ".exr"):
            reads = [partial(read_image, path)]
        else:
            continue
        for read in reads:
            with ends_within(30), warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                try:
                    read()
                except ValueError as error:
                    assert "\n" not in str(error)


def test_bundled_scenes_are_far_from_the_limits():
    for name in scenes.names():
        if not scenes.is_scripted(name):
            assert scenes.read(name).triangles.shape[0] < 2**17
