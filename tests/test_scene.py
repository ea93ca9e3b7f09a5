"""Constructors make scenes of any valid arrays, and name what is invalid in one-line errors."""

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


def test_soup_and_mesh_have_the_same_corners():
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
def test_vertex_colors_become_corner_colors(channels):
    colors = np.random.default_rng(0).random((4, channels)).astype(np.float32)
    scene = sr.Scene.from_mesh(SQUARE, HALVES, vertex_colors=colors)
    np.testing.assert_array_equal(scene.colors, colors[HALVES])


@pytest.mark.parametrize(
    "colors, shape", [((2, 3), (2, 1, 3)), ((2, 4), (2, 1, 4)), ((2, 3, 4), (2, 3, 4))]
)
def test_colors_have_one_or_three_corners_and_their_channels(colors, shape):
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


def test_scenes_may_be_empty():
    assert sr.Scene.from_soup([], []).colors.shape == (0, 1, 3)
    assert sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3, 4))).colors.shape == (0, 3, 4)
    mesh = sr.Scene.from_mesh(SQUARE, [], triangle_colors=np.zeros((0, 4), np.float32))
    assert mesh.triangles.shape == (0, 3)


def test_depth_and_inverse_w_are_per_corner_in_a_soup():
    depth = np.arange(6, dtype=np.float32).reshape(2, 3)
    scene = sr.Scene.from_soup(CORNERS, np.ones((2, 3)), depth=depth, inverse_w=depth + 1)
    assert scene.depth is not None and scene.inverse_w is not None
    np.testing.assert_array_equal(scene.depth, depth.ravel())
    np.testing.assert_array_equal(scene.inverse_w, depth.ravel() + 1)


def test_uv_index_and_textures_must_be_given_together():
    textures = sr.TexturePyramid.build([np.zeros((2, 2, 3), np.float32)])
    uv = np.zeros((2, 3, 2), np.float32)
    ones = np.ones((2, 3), np.float32)
    complete = sr.Scene.from_soup(CORNERS, ones, uv=uv, texture_index=[0, -1], textures=textures)
    assert complete.textures is not None
    with pytest.raises(ValueError, match="go together"):
        sr.Scene.from_soup(CORNERS, ones, uv=uv)
    with pytest.raises(ValueError, match=r"texture_index.*triangle 1"):
        sr.Scene.from_soup(CORNERS, ones, uv=uv, texture_index=[0, 1], textures=textures)


def _refused(match: str, **change) -> None:
    arguments = {
        "positions": SQUARE,
        "triangles": HALVES,
        "triangle_colors": np.ones((2, 4)),
        **change,
    }
    with pytest.raises(ValueError, match=match) as raised:
        sr.Scene.from_mesh(arguments.pop("positions"), arguments.pop("triangles"), **arguments)
    assert "\n" not in str(raised.value)


def _with(array, index, value) -> np.ndarray:
    array = np.array(array)
    array[index] = value
    return array


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(bad):
    _refused(r"positions.*vertex.*2", positions=_with(SQUARE, (2, 1), bad))
    _refused(r"colors.*triangle.*1", triangle_colors=_with(np.ones((2, 4)), (1, 0), bad))
    _refused(r"background", background=[0.5, bad, 0.5])
    _refused(r"depth.*vertex 3", depth=[0, 0, 0, bad])
    _refused(r"inverse_w.*vertex 0", inverse_w=[bad, 1, 1, 1])


@pytest.mark.parametrize("bad", [-0.25, 1.25])
def test_alpha_out_of_range_is_refused(bad):
    _refused(r"alpha.*triangle.*1", triangle_colors=_with(np.ones((2, 4)), (1, 3), bad))
    _refused(r"alpha", background=[0, 0, 0, bad])


@pytest.mark.parametrize("bad", [-1, 4])
def test_indices_out_of_range_are_refused(bad):
    _refused(r"triangles.*triangle.*1", triangles=_with(HALVES, (1, 2), bad))


@pytest.mark.parametrize("bad", [-1, 4])
def test_indices_out_of_range_are_refused_with_vertex_colors(bad):
    with pytest.raises(ValueError, match="triangles"):
        sr.Scene.from_mesh(
            SQUARE, _with(HALVES, (1, 2), bad), vertex_colors=np.ones((4, 3), np.float32)
        )


def test_arrays_of_wrong_shape_are_refused():
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
"""Invalid calls, by the name that their error message must contain (the first word)."""

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
    """Another process runs without the type checks of the tests, which would raise first."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


def test_check_accepts_constructed_scenes_and_batches():
    scene = sr.Scene.from_soup(CORNERS, np.ones((2, 4), np.float32))
    sr.check(scene)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), scene)
    sr.check(batch)
    broken = eqx.tree_at(lambda s: s.positions, batch, batch.positions.at[1, 2].set(jnp.nan))
    with pytest.raises(ValueError, match=r"`positions` .* scene 1, vertex \(2, 0\) has nan"):
        sr.check(broken)
    clear = eqx.tree_at(lambda s: s.background, batch, jnp.float32([[0, 0, 0, 1], [0, 0, 0, 2]]))
    with pytest.raises(ValueError, match=r"`background alpha` must be in 0..1; scene 1 has 2.0"):
        sr.check(clear)


def test_constructors_can_be_traced():
    @jax.jit
    def area(corners):
        scene = sr.Scene.from_soup(corners, jnp.ones((2, 3)))
        sr.check(scene)
        return scene.positions.sum()

    assert float(area(CORNERS)) == CORNERS.sum()


@pytest.mark.parametrize("make", [lambda: sr.Hard(samples=5), lambda: sr.Filter(anisotropy=0)])
def test_options_out_of_range_are_refused(make):
    with pytest.raises(ValueError, match="must be"):
        make()


def test_options_accept_the_numbers_of_numpy_and_jax():
    """Equinox would warn of an array in a static field, and the options would not be equal."""
    assert sr.Hard(np.int64(4), edge_gradients=np.bool_(False)) == sr.Hard(4, edge_gradients=False)
    assert sr.Hard(jnp.int32(4)) == sr.Hard(4) and type(sr.Hard(np.int64(4)).samples) is int
    assert sr.Filter(anisotropy=np.int64(2)) == sr.Filter(anisotropy=2)


def test_rate_is_the_root_of_samples():
    for samples in (1, 4, 9, 16, 64, 256):
        assert sr.Hard(samples=samples).rate ** 2 == samples


HALF = ["float16", "bfloat16"]


def _as_type(scene: sr.Scene, dtype: str) -> sr.Scene:
    """The scene with floats of another type, which no constructor gives."""
    floats = lambda leaf: jnp.issubdtype(leaf.dtype, jnp.floating)  # noqa: E731
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if floats(leaf) else leaf, scene)


@pytest.mark.parametrize("dtype", HALF)
class TestHalfPrecision:
    """Half precision is refused: errors were as large as 0.94, or NaN under `Area`."""

    def test_constructors_refuse_it(self, dtype):
        with pytest.raises(ValueError, match=f"`corners` must be float32 or float64; got {dtype}"):
            sr.Scene.from_soup(jnp.asarray(CORNERS, dtype), np.ones((2, 3)))
        with pytest.raises(ValueError, match=f"`positions` must be float32.*; got {dtype}"):
            sr.Scene.from_mesh(jnp.asarray(SQUARE, dtype), HALVES, vertex_colors=np.ones((4, 3)))

    def test_half_precision_colors_become_exact_float32(self, dtype):
        colors = jnp.asarray(np.full((2, 3), 0.3), dtype)
        scene = sr.Scene.from_soup(CORNERS, colors)
        assert scene.colors.dtype == jnp.float32
        np.testing.assert_array_equal(scene.colors[:, 0], np.asarray(colors, np.float32))

    def test_check_plan_and_render_refuse_scenes_built_directly(self, dtype):
        good = sr.Scene.from_soup(CORNERS, np.ones((2, 3)))
        plan = sr.plan(good, height=4, width=4)
        scene = _as_type(good, dtype)
        calls = [
            lambda: sr.check(scene),
            lambda: sr.plan(scene, height=4, width=4),
            lambda: sr.render(scene, plan),
            lambda: jax.jit(sr.render)(scene, plan),
            lambda: jax.jit(sr.check)(scene),
            lambda: sr.simplify(scene, height=4, width=4),
        ]
        for call in calls:
            with pytest.raises(ValueError, match=f"positions.*got {dtype}") as caught:
                call()
            assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("name", ["colors", "background", "depth", "inverse_w"])
    def test_each_array_is_checked(self, dtype, name):
        scene = sr.Scene.from_soup(
            CORNERS, np.ones((2, 3)), depth=np.ones((2, 3)), inverse_w=np.ones((2, 3))
        )
        broken = eqx.tree_at(lambda s: getattr(s, name), scene, getattr(scene, name).astype(dtype))
        with pytest.raises(ValueError, match=f"`{name}` must be float32"):
            sr.check(broken)

    def test_textures_are_summed_in_single_precision(self, dtype):
        image = jnp.asarray(np.random.default_rng(0).random((33, 17, 3)), dtype)
        half = sr.TexturePyramid.build([image])
        single = sr.TexturePyramid.build([np.asarray(image, np.float32)])
        assert half.texels.dtype == jnp.float32
        np.testing.assert_array_equal(half.texels, single.texels)


@pytest.mark.parametrize("wrap", [2**32, -(2**32), 2**33])
def test_indices_past_32_bits_are_refused(wrap):
    _refused(r"triangles.*triangle \(1, 2\)", triangles=_with(HALVES, (1, 2), 3 + wrap))
    textures = sr.TexturePyramid.build([np.zeros((2, 2, 3), np.float32)])
    _refused(
        r"texture_index.*triangle 1", uv=np.zeros((2, 3, 2)), textures=textures,
        texture_index=np.array([0, wrap]),
    )  # fmt: skip


def test_unsigned_indices_are_checked_without_wrapping():
    largest = np.array(HALVES, np.uint64)
    assert sr.Scene.from_mesh(SQUARE, largest, vertex_colors=np.ones((4, 3))).triangles.shape
    _refused("triangles", triangles=_with(largest, (0, 0), 2**64 - 1))
    _refused("integers|numbers", triangles=[[0, 1, 2**70], [0, 2, 3]])


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.uint16])
def test_integer_colors_above_1_are_refused_as_bytes(dtype):
    many = np.full((2, 3), 200, dtype)
    _refused("`triangle_colors`.*divide bytes by 255", triangle_colors=many)
    _refused("`vertex_colors`.*255", triangle_colors=None, vertex_colors=np.full((4, 3), 2, dtype))
    _refused("`background`.*divide bytes by 255", background=np.array([255, 0, 0], dtype))
    with pytest.raises(ValueError, match=r"`colors`.*divide bytes by 255"):
        sr.Scene.from_soup(CORNERS, many)
    assert sr.Scene.from_soup(CORNERS, np.ones((2, 3), dtype)).colors.dtype == jnp.float32


def test_bytes_are_refused_under_a_trace():
    draw = jax.jit(lambda colors: sr.Scene.from_soup(CORNERS, colors).colors)
    with pytest.raises(ValueError, match="divide bytes by 255; got uint8"):
        draw(np.ones((2, 3), np.uint8))
    build = jax.jit(lambda image: sr.TexturePyramid.build([image]).texels)
    with pytest.raises(ValueError, match=r"texture 0.*divide bytes by 255; got uint8"):
        build(np.ones((2, 2, 3), np.uint8))


def test_floats_that_look_like_bytes_are_warned_of_once():
    white = np.full((2, 3), 255.0)
    with pytest.warns(UserWarning, match="divide them by 255. They are in `triangle_colors`, `ba"):
        scene = sr.Scene.from_soup(CORNERS, white, background=[0.0, 128.0, 3.0])
    assert float(scene.colors.max()) == 255
    with pytest.warns(UserWarning) as caught:
        sr.Scene.from_mesh(SQUARE, HALVES, vertex_colors=np.full((4, 4), [9.0, 0, 0, 1]))
    assert len(caught) == 1
    with pytest.warns(UserWarning, match="texture 0"):
        sr.TexturePyramid.build([np.full((2, 2, 3), 7.0)])


@pytest.mark.parametrize("colors", [1.0, 1.5, 2.25, -1.0, 256.0, 1e6])
def test_light_brighter_than_white_is_not_warned_of(colors):
    """Such colours are drawn unchanged, without a warning. Any warning would fail the test."""
    scene = sr.Scene.from_soup(CORNERS, np.full((2, 3), colors))
    image = sr.render(scene, sr.plan(scene, height=4, width=4))
    np.testing.assert_allclose(image, colors, rtol=1e-6)


@pytest.mark.parametrize("wrong", ["words", [["a", "b"]], [[None, 1.0]], np.array([1j, 2])])
def test_positions_that_are_no_numbers_are_refused(wrong):
    _refused("positions", positions=wrong)


SCRIPT_OF_BYTES = """
import warnings
import numpy as np
import softras2d as sr
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    sr.Scene.from_soup(np.zeros((1, 3, 2)), np.full((1, 3), 255.0))
print(len(caught), caught[0].filename, caught[0].lineno)
"""


def test_the_warning_names_the_line_of_the_caller():
    """Another process runs without the type checks of the tests, which add stack frames."""
    done = subprocess.run([sys.executable, "-c", SCRIPT_OF_BYTES], capture_output=True, text=True)
    assert done.stdout.split() == ["1", "<string>", "7"], done.stderr
