"""Scenes as a user makes them, and what is refused, each in one line that names what and where."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], np.float32)
HALVES = np.array([(0, 1, 2), (0, 2, 3)])
CORNERS = SQUARE[HALVES]


def test_soup_and_mesh_hold_the_same_corners():
    colors = np.array([[1, 0, 0], [0, 1, 0]], np.float32)
    soup = sr.Scene.from_soup(CORNERS, colors)
    mesh = sr.Scene.from_mesh(SQUARE, HALVES, triangle_colors=colors)
    for scene in (soup, mesh):
        np.testing.assert_array_equal(scene.positions[scene.triangles], CORNERS)
        np.testing.assert_array_equal(scene.colors, colors[:, None])
        np.testing.assert_array_equal(scene.background, [1, 1, 1])
    assert soup.positions.shape == (6, 2)
    assert mesh.positions.shape == (4, 2)


@pytest.mark.parametrize("channels", [3, 4])
def test_vertex_colors_reach_the_corners(channels):
    colors = np.random.default_rng(0).random((4, channels)).astype(np.float32)
    scene = sr.Scene.from_mesh(SQUARE, HALVES, vertex_colors=colors)
    np.testing.assert_array_equal(scene.colors, colors[HALVES])


@pytest.mark.parametrize(
    "colors, shape", [((2, 3), (2, 1, 3)), ((2, 4), (2, 1, 4)), ((2, 3, 4), (2, 3, 4))]
)
def test_shape_of_colors_says_what_is_drawn(colors, shape):
    assert sr.Scene.from_soup(CORNERS, np.zeros(colors, np.float32)).colors.shape == shape


def test_lists_and_integers_become_float32():
    scene = sr.Scene.from_soup([[[0, 0], [4, 0], [4, 4]]], [[1, 0, 0]])
    for leaf in (scene.positions, scene.colors, scene.background):
        assert leaf.dtype == jnp.float32
    assert scene.triangles.dtype == jnp.int32


def test_dtype_follows_positions(float64):
    scene = sr.Scene.from_soup(CORNERS.astype(np.float64), np.ones((2, 3), np.float32))
    assert scene.colors.dtype == scene.background.dtype == jnp.float64
    scene = sr.Scene.from_soup(CORNERS, np.ones((2, 3)))
    assert scene.colors.dtype == jnp.float32


def test_empty_scenes():
    assert sr.Scene.from_soup([], []).colors.shape == (0, 1, 3)
    assert sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3, 4))).colors.shape == (0, 3, 4)
    mesh = sr.Scene.from_mesh(SQUARE, [], triangle_colors=np.zeros((0, 4), np.float32))
    assert mesh.triangles.shape == (0, 3)


def test_depth_and_inverse_w_per_corner():
    depth = np.arange(6, dtype=np.float32).reshape(2, 3)
    scene = sr.Scene.from_soup(CORNERS, np.ones((2, 3)), depth=depth, inverse_w=depth + 1)
    assert scene.depth is not None and scene.inverse_w is not None
    np.testing.assert_array_equal(scene.depth, depth.ravel())
    np.testing.assert_array_equal(scene.inverse_w, depth.ravel() + 1)


def test_textures_go_together():
    textures = sr.TexturePyramid.build([np.zeros((2, 2, 3), np.float32)])
    uv = np.zeros((2, 3, 2), np.float32)
    ones = np.ones((2, 3), np.float32)
    whole = sr.Scene.from_soup(CORNERS, ones, uv=uv, texture_index=[0, -1], textures=textures)
    assert whole.textures is not None
    with pytest.raises(ValueError, match="go together"):
        sr.Scene.from_soup(CORNERS, ones, uv=uv)
    with pytest.raises(ValueError, match=r"texture_index.*triangle 1"):
        sr.Scene.from_soup(CORNERS, ones, uv=uv, texture_index=[0, 1], textures=textures)


def _refused(match: str, **change) -> None:
    given = {"positions": SQUARE, "triangles": HALVES, "triangle_colors": np.ones((2, 4)), **change}
    with pytest.raises(ValueError, match=match) as raised:
        sr.Scene.from_mesh(given.pop("positions"), given.pop("triangles"), **given)
    assert "\n" not in str(raised.value)


def _with(array, index, value) -> np.ndarray:
    array = np.array(array)
    array[index] = value
    return array


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(bad):
    _refused(r"positions.*vertex.*2", positions=_with(SQUARE, (2, 1), bad))
    _refused(r"colors.*triangle.*1", triangle_colors=_with(np.ones((2, 4)), (1, 0), bad))
    _refused(r"background", background=[0.5, bad, 0.5])
    _refused(r"depth.*vertex 3", depth=[0, 0, 0, bad])
    _refused(r"inverse_w.*vertex 0", inverse_w=[bad, 1, 1, 1])


@pytest.mark.parametrize("bad", [-0.25, 1.25])
def test_alpha_out_of_range(bad):
    _refused(r"alpha.*triangle.*1", triangle_colors=_with(np.ones((2, 4)), (1, 3), bad))
    _refused(r"alpha", background=[0, 0, 0, bad])


@pytest.mark.parametrize("bad", [-1, 4])
def test_index_out_of_range(bad):
    _refused(r"triangles.*triangle.*1", triangles=_with(HALVES, (1, 2), bad))


@pytest.mark.parametrize("bad", [-1, 4])
def test_index_out_of_range_with_vertex_colors(bad):
    with pytest.raises(ValueError, match="triangles"):
        sr.Scene.from_mesh(
            SQUARE, _with(HALVES, (1, 2), bad), vertex_colors=np.ones((4, 3), np.float32)
        )


def test_shapes_that_do_not_fit():
    _refused("triangle_colors", triangle_colors=np.ones((3, 4)))
    _refused("channels", triangle_colors=np.ones((2, 2)))
    _refused("corners", triangle_colors=np.ones((2, 2, 3)))
    _refused("background", background=[1, 1])
    _refused("vertex_colors", triangle_colors=None, vertex_colors=np.ones((3, 3)))
    _refused("one of", triangle_colors=None)
    _refused("one of", vertex_colors=np.ones((4, 3)))
    with pytest.raises(ValueError, match="corners"):
        sr.Scene.from_soup(SQUARE, np.ones((2, 3)))


REFUSED = {
    "positions [vertices, 3]": "mesh(np.zeros((4, 3)), HALVES)",
    "positions [vertices]": "mesh(np.zeros(4), HALVES)",
    "triangles [triangles, 4]": "mesh(SQUARE, [[0, 1, 2, 3]])",
    "triangles [3]": "mesh(SQUARE, [0, 1, 2])",
    "triangles of floats": "mesh(SQUARE, [[0.0, 1.5, 2.0]])",
    "depth": "mesh(SQUARE, HALVES, depth=np.zeros(3))",
    "inverse_w": "mesh(SQUARE, HALVES, inverse_w=np.zeros((4, 1)))",
    "background [1, 3]": "mesh(SQUARE, HALVES, background=np.ones((1, 3)))",
    "uv": "mesh(SQUARE, HALVES, uv=np.zeros((2, 2)), texture_index=[0, 0], textures=TEXTURES)",
    "texture_index": (
        "mesh(SQUARE, HALVES, uv=np.zeros((2, 3, 2)), texture_index=[0], textures=TEXTURES)"
    ),
    "fill_rule": "sr.Hard(fill_rule='odd')",
    "shading": "sr.Hard(shading='vertex')",
    "profile": "sr.Soft(profile='box')",
    "border": "sr.TexturePyramid.build([np.zeros((2, 2, 3))], border='mirror')",
}
"""By what the message must name (its first word): calls that no type check stops for users."""

SCRIPT = f"""
import numpy as np
import softras2d as sr
SQUARE = np.zeros((4, 2), np.float32)
HALVES = np.array([(0, 1, 2), (0, 2, 3)])
TEXTURES = sr.TexturePyramid.build([np.zeros((2, 2, 3))])
def mesh(positions, triangles, **options):
    colors = np.ones((len(triangles) if np.ndim(triangles) == 2 else 1, 3))
    return sr.Scene.from_mesh(positions, triangles, triangle_colors=colors, **options)
for name, call in {REFUSED!r}.items():
    try:
        eval(call)
    except ValueError as error:
        if name.split()[0] in str(error) and chr(10) not in str(error):
            continue
        print(name, "is not named:", error)
    except Exception as error:
        print(name, "raises", type(error).__name__, error)
    else:
        print(name, "is accepted")
"""


def test_shapes_and_options_are_refused_without_type_checks():
    """As users run it: the run-time type checks of these tests would speak first."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


def test_check_passes_what_constructors_made_and_batches():
    scene = sr.Scene.from_soup(CORNERS, np.ones((2, 4), np.float32))
    sr.check(scene)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), scene)
    sr.check(batch)
    broken = eqx.tree_at(lambda s: s.positions, batch, batch.positions.at[1, 2].set(jnp.nan))
    with pytest.raises(ValueError, match="vertex"):
        sr.check(broken)


def test_constructors_can_be_traced():
    @jax.jit
    def area(corners):
        scene = sr.Scene.from_soup(corners, jnp.ones((2, 3)))
        sr.check(scene)
        return scene.positions.sum()

    assert float(area(CORNERS)) == CORNERS.sum()


@pytest.mark.parametrize("make", [lambda: sr.Hard(samples=5), lambda: sr.Filter(anisotropy=0)])
def test_options_out_of_range(make):
    with pytest.raises(ValueError, match="must be"):
        make()


def test_rate_is_the_root_of_samples():
    for samples in (1, 4, 9, 16, 64, 256):
        assert sr.Hard(samples=samples).rate ** 2 == samples
