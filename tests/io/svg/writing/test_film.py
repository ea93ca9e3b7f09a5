"""Films are written as animated SVG files."""

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

SVG = "{http://www.w3.org/2000/svg}"


def film(frames: int) -> list[sr.Scene]:
    """Frames of one triangle that moves right and changes from red to blue, and of a still one."""
    return [
        sr.Scene.from_soup(
            [[[k, 0], [k + 5, 0], [k, 5.25]], [[1, 1], [2, 1], [1, 2]]],
            [[1 - k / (frames - 1), 0, k / (frames - 1)], [0, 1, 0]],
        )
        for k in range(frames)
    ]


def test_what_changes_is_animated(tmp_path):
    sr.write_svg_film(
        tmp_path / "a.svg", film(3), height=20, width=30, seconds_per_frame=0.5, digits=1
    )
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    moving, still = root.findall(f"{SVG}polygon")
    assert moving.get("points") == "0 0 5 0 0 5.2" and len(still) == 0
    points, fill = moving
    assert points.get("values") == "0 0 5 0 0 5.2;1 0 6 0 1 5.2;2 0 7 0 2 5.2"
    assert fill.get("values", "").split(";") == ["#f00", "#800080", "#00f"]
    assert {a.get("dur") for a in moving} == {"1.5s"}
    assert {a.get("calcMode") for a in moving} == {"discrete"}


def test_a_reader_of_still_images_sees_the_first_frame(tmp_path):
    sr.write_svg_film(tmp_path / "a.svg", film(3), height=20, width=30)
    with pytest.warns(UserWarning, match="animat"):
        scene = sr.read_svg(tmp_path / "a.svg")
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    np.testing.assert_allclose(corners[-2], [[0, 0], [5, 0], [0, 5.2]], atol=1e-6)


FIRST, SECOND = film(2)
DEEP = [FIRST, replace(SECOND, depth=SECOND.positions[:, 0])]
PERSPECTIVE = [replace(scene, inverse_w=1 + scene.positions[:, 0]) for scene in film(2)]
TEXTURED = [
    sr.Scene.from_soup(
        [[[0, 0], [5, 0], [0, 5]]],
        [[1, 1, 1]],
        uv=[[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]],
        texture_index=[0],
        textures=sr.TexturePyramid.build([np.ones((2, 2, 3), np.float32)]),
    )
]
BATCH = [jax.tree.map(lambda *arrays: jnp.stack(arrays), FIRST, SECOND)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenes": []}, "there are no frames"),
        ({"digits": 9}, "`digits` must be an integer in 0..6; got 9"),
        ({"height": 0}, "`height` and `width` must be numbers of pixels, 1 or more; got 0 and 9"),
        ({"width": math.inf}, "`height` and `width` must be numbers of pixels, 1 or more; got 9"),
        ({"height": True}, "`height` and `width` must be numbers of pixels, 1 or more; got True"),
        ({"scenes": DEEP}, "a.svg: frame 1: SVG cannot represent `depth`: it must be None"),
        ({"scenes": PERSPECTIVE}, "frame 0: SVG cannot represent `inverse_w`"),
        ({"scenes": TEXTURED}, "frame 0: SVG cannot represent `textures`"),
        ({"scenes": BATCH}, "frame 0: an SVG shows one scene, not a batch"),
        ({"seconds_per_frame": 0.0}, "`seconds_per_frame` must be a number above 0; got 0.0"),
        ({"seconds_per_frame": "a"}, "`seconds_per_frame` must be a number above 0; got 'a'"),
        ({"scenes": [*film(2), sr.Scene.from_soup([], [])]}, "equal shapes"),
        ({"scenes": [FIRST, replace(SECOND, background=jnp.zeros(4))]}, "equal shapes"),
    ],
)
def test_errors(tmp_path, change, message):
    arguments = {"scenes": film(2), "height": 9, "width": 9} | change
    with pytest.raises(ValueError, match=message):
        sr.write_svg_film(tmp_path / "a.svg", **arguments)
