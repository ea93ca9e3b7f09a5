"""`write_svg`: every float32 is read back exactly, browsers have fallbacks, errors are one line."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr
from softras2d.io.svg.writing.writer import _paint_attributes, _shortest

RNG = np.random.default_rng(7)
UNIT = st.floats(0.0, 1.0, width=32)


def floats(values) -> np.ndarray:
    return np.asarray(values, np.float32)


def soup(count: int, *shape: int, background=None) -> sr.Scene:
    """Triangles whose floats need all digits of float32, some off the canvas."""
    corners = ((RNG.random((count, 3, 2)) * 1.4 - 0.2) * 90).astype(np.float32)
    return sr.Scene.from_soup(
        corners, RNG.random((count, *shape)).astype(np.float32), background=background
    )


def textured(colors=None, **options) -> sr.Scene:
    """A scene of three triangles: two with textures, and one without between them."""
    images = [
        RNG.integers(0, 256, (3, 5, 3)).astype(np.float32) / np.float32(255),
        RNG.random((4, 4, 3)).astype(np.float32),
    ]
    return sr.Scene.from_soup(
        RNG.random((3, 3, 2)).astype(np.float32) * 50,
        floats([[1, 1, 1], [0.2, 0.4, 0.6], [1, 1, 1]]) if colors is None else colors,
        uv=RNG.random((3, 3, 2)).astype(np.float32),
        texture_index=[1, -1, 0],
        textures=sr.TexturePyramid.build(images, **options),
    )


def elements(path) -> list[ElementTree.Element]:
    root = ElementTree.parse(path).getroot()
    for element in root:
        element.tag = element.tag.split("}")[-1]
    return list(root)


def assert_same(read: sr.Scene, written: sr.Scene) -> None:
    """Assert equal triangles, colours and background, however vertices are shared."""
    corners, expected = (np.asarray(s.positions)[np.asarray(s.triangles)] for s in (read, written))
    np.testing.assert_array_equal(corners, expected)
    np.testing.assert_array_equal(read.colors, written.colors)
    np.testing.assert_array_equal(read.background, written.background)


@pytest.mark.parametrize("shape", [(3,), (4,), (3, 3), (3, 4)], ids=str)
@pytest.mark.parametrize("background", [None, (0.1, 1 / 3, 0.9999999)], ids=["white", "colour"])
def test_reading_gives_back_the_same_arrays(tmp_path, shape, background):
    scene = soup(60, *shape, background=background)
    sr.write_svg(tmp_path / "scene.svg", scene, height=91, width=67)
    assert_same(sr.read_svg(tmp_path / "scene.svg"), scene)
    root = ElementTree.parse(tmp_path / "scene.svg").getroot()
    assert [root.get(k) for k in ("width", "height", "viewBox")] == ["67", "91", "0 0 67 91"]


def test_degenerate_and_shared_triangles_are_read_back(tmp_path):
    scene = sr.Scene.from_mesh(
        floats([[0, 0], [10, 0], [0, 10], [20, 0], [1e-7, 1e7], [-0.0, 3.5]]),
        [[0, 1, 2], [2, 1, 0], [0, 1, 3], [1, 1, 1], [0, 4, 3], [5, 2, 0]],
        triangle_colors=RNG.random((6, 3)).astype(np.float32),
    )
    sr.write_svg(tmp_path / "scene.svg", scene, height=10, width=10)
    assert_same(sr.read_svg(tmp_path / "scene.svg"), scene)


@pytest.mark.parametrize("shape", [(3,), (3, 3)], ids=str)
def test_colours_outside_0_to_1_are_read_back(tmp_path, shape):
    corners = floats(RNG.random((8, 3, 2)))
    scene = sr.Scene.from_soup(corners, floats(RNG.standard_normal((8, *shape)) * 3))
    sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    assert_same(sr.read_svg(tmp_path / "scene.svg"), scene)


def test_an_empty_scene_is_read_back(tmp_path):
    scene = sr.Scene.from_soup([], [], background=[0.0, 0.25, 0.5])
    sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    read = sr.read_svg(tmp_path / "scene.svg")
    assert read.triangles.shape == (0, 3)
    np.testing.assert_array_equal(read.background, scene.background)


def test_writing_again_gives_the_same_file(tmp_path):
    sr.write_svg(tmp_path / "a.svg", soup(30, 3, 4), height=64, width=64)
    sr.write_svg(tmp_path / "b.svg", sr.read_svg(tmp_path / "a.svg"), height=64, width=64)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_flat_triangles_are_polygons(tmp_path):
    scene = sr.Scene.from_soup(
        floats([[[0, 0], [10.1, 0], [0, 1e-7]]]),
        floats([[0.1, 1, 0, 0.5]]),
        background=floats([0, 0, 0.07]),
    )
    sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    rect, polygon = elements(tmp_path / "scene.svg")
    assert rect.tag == "rect"
    assert rect.attrib == {"x": "0", "y": "0", "width": "4", "height": "3", "fill": "rgb(0% 0% 7%)"}
    assert polygon.tag == "polygon"
    assert polygon.get("points") == "0,0 10.1,0 0,1e-07"
    assert polygon.get("fill") == "rgb(10% 100% 0%)"
    assert polygon.get("fill-opacity") == "0.5"


def test_equal_corner_colours_are_a_polygon_in_draw_order(tmp_path):
    colors = RNG.random((3, 3, 3)).astype(np.float32)
    colors[1] = colors[1, 0]
    scene = sr.Scene.from_soup(RNG.random((3, 3, 2)).astype(np.float32), colors)
    sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    assert [e.tag for e in elements(tmp_path / "scene.svg")] == ["colortri", "polygon", "colortri"]
    assert_same(sr.read_svg(tmp_path / "scene.svg"), scene)


@pytest.mark.parametrize("shape", [(3,), (3, 3), (3, 4)], ids=str)
def test_fallbacks_are_not_read(tmp_path, shape):
    scene = soup(20, *shape, background=floats([0.25, 0.5, 1]))
    sr.write_svg(tmp_path / "a.svg", scene, height=64, width=64)
    sr.write_svg(tmp_path / "b.svg", scene, height=64, width=64, fallback=True)
    plain, marked = sr.read_svg(tmp_path / "a.svg"), sr.read_svg(tmp_path / "b.svg")
    assert jax.tree.structure(plain) == jax.tree.structure(marked)
    jax.tree.map(np.testing.assert_array_equal, plain, marked)
    beside = [e for e in elements(tmp_path / "b.svg") if "data-fallback" in e.attrib]
    paths = [e for e in beside if e.tag == "path" and e.get("display") is None]
    assert len(paths) == (0 if shape == (3,) else 20)
    if shape == (3,):
        assert not beside


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_translucent_background_is_a_rect_over_white(tmp_path, alpha):
    scene = soup(1, 3, background=floats([0.2, 0.4, 0.6, alpha]))
    sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    rect = elements(tmp_path / "scene.svg")[0]
    assert rect.get("fill-opacity") == (None if alpha == 1 else f"{alpha:g}")
    read = sr.read_svg(tmp_path / "scene.svg")
    opaque = alpha == 1
    np.testing.assert_array_equal(read.background, scene.background[:3] if opaque else np.ones(3))
    corners = np.asarray(read.positions)[np.asarray(read.triangles)]
    np.testing.assert_array_equal(corners[-1], scene.positions)
    np.testing.assert_array_equal(np.asarray(read.colors)[-1, 0, :3], scene.colors[0, 0])
    assert (len(corners) == 1) == opaque
    if not opaque:
        np.testing.assert_array_equal(np.asarray(read.colors)[:-1, 0, 3], floats(alpha))


@given(st.lists(UNIT, min_size=3, max_size=3))
def test_percentages_give_exact_float32(rgb):
    wanted = floats(rgb)
    percent = re.findall(r"([^ (]+)%", _paint_attributes(wanted[None])[0])
    got = (np.array(percent, np.float64) / 100).astype(np.float32)
    np.testing.assert_array_equal(got, wanted)


@given(st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_numbers_give_exact_float32(value):
    (text,) = _shortest(floats([value])).tolist()
    assert floats(float(text)) == floats(value)
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]\d+)?", text)


def test_many_float32_of_the_unit_interval_survive():
    bits = RNG.integers(0, 0x3F800001, 150_000, dtype=np.uint32)
    wanted = bits.view(np.float32).reshape(-1, 3)
    percent = re.findall(r"([^ (]+)%", " ".join(_paint_attributes(wanted)))
    got = (np.array(percent, np.float64) / 100).astype(np.float32)
    np.testing.assert_array_equal(got.reshape(-1, 3), wanted)


def test_textures_are_written_beside_the_drawing(tmp_path):
    scene = textured()
    sr.write_svg(tmp_path / "a & b.svg", scene, height=50, width=50)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "a & b.svg",
        "a & b_texture0.png",
        "a & b_texture1.png",
    ]
    tags = [e.tag for e in elements(tmp_path / "a & b.svg")]
    assert tags == ["texture", "texture", "textri", "polygon", "textri"]
    read = sr.read_svg(tmp_path / "a & b.svg")
    assert_same(read, scene)
    assert read.uv is not None and scene.uv is not None
    assert read.textures is not None and scene.textures is not None
    index = np.asarray(scene.texture_index)
    np.testing.assert_array_equal(np.asarray(read.texture_index) >= 0, index >= 0)
    np.testing.assert_array_equal(np.asarray(read.uv)[index >= 0], np.asarray(scene.uv)[index >= 0])
    # The texture of triangle 2 consists of bytes and is exact. That of triangle 0 is rounded to 16
    # bits.
    np.testing.assert_array_equal(base_level(read, 2), base_level(scene, 2))
    np.testing.assert_allclose(base_level(read, 0), base_level(scene, 0), atol=0.6 / 65535)


def base_level(scene: sr.Scene, triangle: int) -> np.ndarray:
    """The texels of a triangle's texture. Its index may change by writing and reading."""
    assert scene.textures is not None and scene.texture_index is not None
    index = int(scene.texture_index[triangle])
    offset, height, width = np.asarray(scene.textures.levels)[index, 0].tolist()
    texels = np.asarray(scene.textures.texels)[offset : offset + height * width]
    return texels.reshape(height, width, -1)


NAN = jnp.asarray([[np.nan, 0], [1, 0], [0, 1]], jnp.float32)
ONE = sr.Scene.from_soup(np.ones((1, 3, 2), np.float32), np.ones((1, 3), np.float32))
REFUSED = {
    "depth": (replace(ONE, depth=jnp.zeros(3)), "SVG cannot represent `depth`"),
    "inverse_w": (replace(ONE, inverse_w=jnp.ones(3)), "SVG cannot represent `inverse_w`"),
    "nan": (replace(ONE, positions=NAN), "`positions` must be finite; vertex"),
    "batch": (jax.tree.map(lambda leaf: leaf[None], ONE), "not a batch"),
    "tint": (textured(np.full((3, 3), 0.5, np.float32)), "triangle 0 is not"),
    "repeat": (textured(border="repeat"), "border 'clamp'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_svg_cannot_express_is_refused_before_writing(tmp_path, case):
    scene, message = REFUSED[case]
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        sr.write_svg(tmp_path / "scene.svg", scene, height=3, width=4)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_float64_is_rounded_to_float32(tmp_path, float64):
    corners = RNG.random((5, 3, 2)) * 40
    colors = RNG.random((5, 4))
    sr.write_svg(tmp_path / "a.svg", sr.Scene.from_soup(corners, colors), height=40, width=40)
    rounded = sr.Scene.from_soup(corners.astype(np.float32), colors.astype(np.float32))
    sr.write_svg(tmp_path / "b.svg", rounded, height=40, width=40)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    huge = sr.Scene.from_soup(corners * 1e39, colors)
    with pytest.raises(ValueError, match="`positions` must be finite in float32"):
        sr.write_svg(tmp_path / "c.svg", huge, height=40, width=40)


def test_unwritable_paths_are_refused_in_one_line(tmp_path):
    with pytest.raises(ValueError, match="folder to write to does not exist"):
        sr.write_svg(tmp_path / "no" / "scene.svg", ONE, height=3, width=4)
    (tmp_path / "folder.svg").mkdir()
    with pytest.raises(ValueError, match="cannot be written"):
        sr.write_svg(tmp_path / "folder.svg", ONE, height=3, width=4)
    with pytest.raises(ValueError, match="must be numbers of pixels, 1 or more; got 0 and 4"):
        sr.write_svg(tmp_path / "scene.svg", ONE, height=0, width=4)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.svg"]
