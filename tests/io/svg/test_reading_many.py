"""Reading many drawings compiles nothing, so the memory of the process does not grow."""

from pathlib import Path

import pytest

import softras2d as sr
from softras2d.io.svg.reading.reader import parse_svg

from ...cases.marks import slowly


@pytest.mark.parametrize("step", [20, slowly(1)])
def test_drawings_of_many_sizes_compile_nothing(count_compilations, step):
    with count_compilations() as compiled:
        for count in range(0, 200, step):
            shapes = '<rect width="9" height="9" fill="#123456"/>' * (1 + count)
            glass = '<line stroke="red" stroke-opacity=".5" x2="9" y2="5"/>' * (count % 3)
            scene = parse_svg(
                f'<svg xmlns="http://www.w3.org/2000/svg" width="{20 + count}" height="20">'
                f"{shapes}{glass}</svg>"
            )
            assert scene.triangles.shape[0] >= 2 * (1 + count) - 2
            sr.simplify(scene, height=20, width=20 + count)
    assert compiled.names == []


def test_drawings_with_pictures_compile_nothing(count_compilations, tmp_path: Path):
    with count_compilations() as compiled:
        for side in range(1, 20):
            image = sr.read_image(sr.pictures.path("fruit"))[:side, : 2 * side]
            sr.write_image(tmp_path / "a.png", image)
            scene = tmp_path / "a.svg"
            scene.write_text(
                '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="20">'
                f'<image href="a.png" width="{side}" height="9"/></svg>'
            )
            assert sr.read_svg(scene).textures is not None
    assert compiled.names == []
