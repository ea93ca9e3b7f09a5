"""The `repr` of scenes, textures, plans, buffers and fits is short, and never raises an error."""

from dataclasses import fields, replace

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.result import Record
from softras2d.planning.effects import EFFECTS

CORNERS = np.array([[[2, 3], [25, 4], [8, 17]], [[0, 0], [9, 0], [28, 18.0]]], np.float32)
FLAT = sr.Scene.from_soup(CORNERS, np.ones((2, 3)))
TEXTURES = sr.TexturePyramid.build([np.ones((8, 4, 3)), np.ones((2, 2, 4))], border="repeat")
RICH = sr.Scene.from_soup(
    CORNERS,
    np.full((2, 3, 4), 0.5),
    background=[1, 1, 1, 0],
    uv=np.zeros((2, 3, 2)),
    texture_index=[0, -1],
    textures=TEXTURES,
    depth=np.zeros((2, 3)),
    inverse_w=np.ones((2, 3)),
)


def test_a_scene_is_counts_and_extent_then_effects():
    assert repr(FLAT) == (
        "Scene: 2 triangles, 6 vertices, float32, x 0 to 28 px, y 0 to 18 px\n  flat colour, opaque"
    )
    assert repr(RICH) == (
        "Scene: 2 triangles, 6 vertices, 2 textures, float32, x 0 to 28 px, y 0 to 18 px\n"
        "  interpolated colour, translucency, translucent background, texture, perspective, "
        "depth test"
    )


def test_effects_have_the_names_of_plans_in_their_order():
    shown = repr(RICH).splitlines()[1].strip().split(", ")
    planned = sr.plan(RICH, height=20, width=30).effects
    filters = ("mip levels", "bilinear filter", "guard band")
    assert shown == [name for name in planned if name not in filters]
    assert shown == [name for name in EFFECTS if name in shown]


def test_translucency_of_texels_alone_counts():
    scene = replace(RICH, colors=RICH.colors[..., :3])
    assert "translucency" in repr(scene)
    assert "translucency" in sr.plan(scene, height=20, width=30).effects


def test_only_vertices_that_triangles_use_make_the_extent():
    assert repr(sr.pad(FLAT)).splitlines()[0].endswith("float32, x 0 to 28 px, y 0 to 18 px")
    moved = replace(FLAT, positions=FLAT.positions + 5)
    assert "x 5 to 33 px" in repr(moved)
    assert "x 5 to 33 px" in repr(sr.pad(moved))


@pytest.mark.parametrize("scene", [FLAT, RICH], ids=["flat", "rich"])
def test_structures_without_values_say_so(scene):
    effects = repr(scene).splitlines()[1]
    texts = []

    def note(traced):
        texts.append(repr(traced))
        return traced.positions

    # A tracer raises an error if its value is read.
    jax.jit(note)(scene)
    jax.vmap(note)(batch_of(scene, 3))
    jax.grad(lambda scene: note(scene).sum(), allow_int=True)(scene)
    jax.grad(lambda positions: note(replace(scene, positions=positions)).sum())(scene.positions)
    for text in texts:
        first, second = text.splitlines()
        assert first.endswith("float32, traced")
        assert second == effects
    first, second = repr(jax.eval_shape(lambda: scene)).splitlines()
    assert first.endswith("float32, no values")
    assert second == effects


def batch_of(scene, size):
    return jax.tree.map(lambda leaf: np.stack([leaf] * size), scene)


def test_a_batch_gives_its_size_and_the_counts_of_each_scene():
    first, second = repr(batch_of(FLAT, 3)).splitlines()
    assert first == (
        "Batch of 3 scenes, each: 2 triangles, 6 vertices, float32, x 0 to 28 px, y 0 to 18 px"
    )
    assert second == "  flat colour, opaque"
    assert repr(batch_of(batch_of(FLAT, 3), 4)).startswith("Batch of 4 x 3 scenes, each: 2 tri")


def test_vertices_that_are_not_finite_are_counted():
    positions = FLAT.positions.at[1].set(np.nan).at[5].set(np.inf)
    invalid = replace(FLAT, positions=positions)
    assert repr(invalid).splitlines()[0] == (
        "Scene: 2 triangles, 6 vertices, float32, x 0 to 9 px, y 0 to 17 px, 2 vertices not finite"
    )
    nowhere = replace(FLAT, positions=positions * np.nan)
    assert repr(nowhere).splitlines()[0].endswith("float32, 6 vertices not finite")


def test_an_empty_scene_has_no_extent():
    assert repr(sr.Scene.from_soup([], [])).startswith("Scene: 0 triangles, 0 vertices, float32\n")


class Refuses:
    """An object that raises an error on any access."""

    def __getattr__(self, name):
        raise RuntimeError(name)

    def __repr__(self):
        raise RuntimeError("repr")


LEAVES = {
    "None": None,
    "number": 0,
    "text": "text",
    "tuple": (),
    "object that raises": Refuses(),
    "class": Refuses,
    "scalar": np.float32(1),
}


@pytest.mark.parametrize("kind", LEAVES)
@pytest.mark.parametrize("name", [None, *(field.name for field in fields(sr.Scene))])
def test_strange_leaves_are_named_instead_of_raising(kind, name):
    leaf = LEAVES[kind]
    if name is None:
        strange = jax.tree.map(lambda _: leaf, RICH)
    else:
        # `tree_at` replaces a field without the checks of the constructor.
        strange = eqx.tree_at(lambda s: getattr(s, name), RICH, leaf, is_leaf=lambda x: x is None)
    first, second = repr(strange).splitlines()
    assert first.startswith("Scene: ")
    if name in ("positions", "triangles", "colors") and kind != "scalar":
        assert f"{name} ({type(leaf).__name__})" in second
    if name in (None, "positions", "triangles", "colors"):
        assert strange._repr_html_() is None


def test_arrays_of_any_shape_and_dtype_are_described():
    rng = np.random.default_rng(0)
    dtypes = [np.float32, np.int32, np.uint8, bool, complex, jax.dtypes.float0, jnp.bfloat16, "U3"]

    def any_array():
        shape = tuple(rng.choice([0, 1, 2, 3, 4], rng.integers(0, 5)).tolist())
        return np.zeros(shape, dtypes[rng.integers(len(dtypes))])

    for _ in range(300):
        scene = jax.tree.map(lambda _: any_array(), RICH)
        assert len(repr(scene).splitlines()) == 2
        assert len(repr(scene.textures).splitlines()) == 1
    keys = jax.tree.map(lambda _: jax.random.key(0), RICH)
    assert len(repr(keys).splitlines()) == 2


def test_sizes_may_be_symbols():
    count = jax.export.symbolic_shape("count")[0]
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape), leaf.dtype), FLAT)
    assert repr(shapes).startswith("Batch of count scenes, each: 2 triangles")
    flat = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape[1:]), "f4"), FLAT)
    assert repr(flat).startswith("Scene: count triangles, count vertices, float32")


def test_half_made_and_deleted_scenes_are_described():
    assert repr(object.__new__(sr.Scene)).startswith("Scene: no arrays\n  not arrays: positions")
    assert repr(object.__new__(sr.TexturePyramid)).startswith("TexturePyramid: ")
    donated = jax.tree.map(lambda leaf: jax.device_put(np.array(leaf)), FLAT)
    donated.positions.delete()
    assert repr(donated).splitlines()[0] == "Scene: 2 triangles, 6 vertices, float32, no values"


def test_parts_of_a_scene_are_described():
    gradient = eqx.filter(FLAT, eqx.is_inexact_array)
    assert repr(gradient) == (
        "Scene: 2 triangles, 6 vertices, float32\n"
        "  flat colour, opaque, not arrays: triangles (NoneType)"
    )


def test_a_pyramid_is_one_line():
    assert repr(TEXTURES) == (
        "TexturePyramid: 2 textures, 4 levels, 4 channels, largest 4 x 8 texels, float32, repeat, "
        "half_texel"
    )
    shapes = jax.eval_shape(lambda: TEXTURES)
    assert "4 channels, float32" in repr(shapes)
    texts = []
    jax.jit(lambda textures: texts.append(repr(textures)))(TEXTURES)
    assert "4 channels, traced, float32" in texts[0]
    for leaf in (None, 0, Refuses()):
        assert repr(jax.tree.map(lambda _, leaf=leaf: leaf, TEXTURES)).startswith("TexturePyramid:")


def test_a_plan_is_two_lines_and_prints_in_full():
    plan = sr.plan(FLAT, height=20, width=30, coverage=sr.Hard(samples=4))
    assert repr(plan) == (
        "Plan: 30 x 20 px, hard, 4 samples per pixel, inclusive, shaded by sample\n  no effects"
    )
    assert len(str(plan).splitlines()) > 4
    soft = sr.plan(RICH, height=20, width=30, coverage=sr.Soft(width=2.0))
    first, second = repr(soft).splitlines()
    assert first == "Plan: 30 x 20 px, soft, logistic, 2 px wide, temperature 0.01"
    assert second.strip() == ", ".join(soft.effects)
    texts = []
    jax.jit(lambda plan: texts.append(repr(plan)))(soft)
    assert texts[0].startswith("Plan: 30 x 20 px, Soft\n")
    assert repr(jax.tree.map(lambda _: None, soft)).startswith("Plan: 30 x 20 px, Soft\n")


def test_visibility_buffers_are_their_shape_and_the_scene():
    plan = sr.plan(FLAT, height=20, width=30, coverage=sr.Hard(samples=4))
    visible = sr.Visibility(jnp.zeros((20, 30, 4), jnp.int32), FLAT, plan, jnp.array(False))
    assert repr(visible) == f"Visibility: triangle [20, 30, 4]\n  {repr(FLAT).splitlines()[0]}"
    layers = jnp.zeros((20, 30, 4), jnp.int32)
    values = jnp.zeros((20, 30, 4)), jnp.zeros((20, 30, 4, 3))
    pixel_layers = sr.PixelLayers(layers, *values, FLAT, plan)
    assert (
        repr(pixel_layers) == f"PixelLayers: triangle [20, 30, 4]\n  {repr(FLAT).splitlines()[0]}"
    )
    texts = []
    jax.jit(lambda visible: texts.append(repr(visible)))(visible)
    assert texts[0].endswith("float32, traced")
    for leaf in LEAVES.values():
        strange = jax.tree.map(lambda _, leaf=leaf: leaf, visible)
        assert repr(strange).startswith("Visibility: triangle []\n  Scene: ")
    assert repr(object.__new__(sr.Visibility)).startswith("Visibility: triangle []\n  Scene: ")


def test_a_fit_is_its_scores_and_sizes():
    history = (Record(300, 12.34, 20.0, 0.9, 7, 5),)
    image = np.zeros((20, 30, 3), np.float32)
    result = sr.FitResult(FLAT, image, 27.3149, 0.8126, history, {}, interrupted=True)
    assert repr(result) == (
        "FitResult: PSNR 27.31 dB, SSIM 0.813\n"
        "  2 triangles, 30 x 20 px, 300 steps in 12.3 s, interrupted"
    )
    perfect = sr.FitResult(FLAT, image, np.inf, 1.0, (), {})
    assert repr(perfect) == "FitResult: PSNR inf dB, SSIM 1.000\n  2 triangles, 30 x 20 px"
