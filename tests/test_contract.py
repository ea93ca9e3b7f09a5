"""The contract of derivatives, as one table: every coverage, and every input that it draws.

Of each: both directions of differentiation agree, nothing is infinite or NaN, an outer jit and a
batch change nothing, and what must be zero is exactly zero. An effect that a coverage comes to draw
is a word more in its entry of `MODES`.
"""

import functools
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

import softras2d as sr

from .cases.derivatives import inner, is_finite, weight_of
from .cases.products import Products, float_leaves, products, stack

SIZE = 16
"""Two tiles a side."""

HIDDEN, COVER, POINT, AWAY = range(4)
"""Triangles: one behind another that hides it, one without area, one off the canvas."""

COUNT = 10


class Mode(NamedTuple):
    """A coverage, the effects that it draws, and what of its slopes is zero.

    - `effects`: of `corners` (colours), `alpha`, `texture`, `depth`, `perspective`, and `clear` (a
      background of four channels).
    - `zero`: inputs without any slope.
    - `hides`: whether a triangle hides what lies behind it. A mixture by depth hides nothing: what
      lies deeper has a weight, however small. A sum neither.
    """

    coverage: sr.Hard | sr.Soft | sr.Area
    effects: str
    zero: tuple[str, ...] = ()
    hides: bool = True

    @property
    def inputs(self) -> tuple[str, ...]:
        names = ["positions", "colors", "background"]
        names += ["uv", "textures"] * ("texture" in self.effects)
        names += ["depth"] * ("depth" in self.effects)
        return (*names, *["inverse_w"] * ("perspective" in self.effects))


ALL = "corners alpha texture depth perspective clear"
OPAQUE = "corners texture depth perspective"
GLASS = "corners alpha texture perspective clear"

MODES = {
    "hard": Mode(sr.Hard(4), "corners"),
    "hard-textured": Mode(sr.Hard(4), OPAQUE),
    "hard-all": Mode(sr.Hard(4), ALL, zero=("depth",)),
    "hard-still": Mode(sr.Hard(4, edge_gradients=False), "depth", zero=("positions", "depth")),
    "soft": Mode(sr.Soft(1.3), "corners alpha"),
    "soft-textured": Mode(sr.Soft(1.3, "window"), GLASS),
    "soft-all": Mode(sr.Soft(1.3, temperature=0.3), ALL, hides=False),
    "soft-paper": Mode(sr.Soft(1.3, "softras"), "clear"),
    "area": Mode(sr.Area(), "alpha clear"),
    "area-all": Mode(sr.Area(), GLASS),
    "sum": Mode(sr.Area("sum"), "", hides=False),
    "sum-textured": Mode(sr.Area("sum"), "corners texture perspective", hides=False),
}

RICHEST = ("hard-textured", "hard-all", "soft-textured", "soft-all", "area-all", "sum-textured")
"""That have the effects of the others too."""

QUICK = ("hard", "soft")
"""Whose rows are no long tests."""


def rows(modes: Any = tuple(MODES)) -> list[Any]:
    """Modes with every input that they draw."""
    return [
        pytest.param(mode, name, marks=() if mode in QUICK else pytest.mark.slow)
        for mode in modes
        for name in MODES[mode].inputs
    ]


def scene_of(effects: str, dtype: type = np.float32, seed: int = 0) -> sr.Scene:
    """Triangles of a few pixels, over and beside one that covers the left of the canvas."""
    rng = np.random.default_rng(seed)
    corners = rng.random((COUNT, 1, 2)) * SIZE + rng.normal(size=(COUNT, 3, 2)) * 4
    corners[COVER] = [(7.7, -30), (7.2, 46), (-30, 8)]
    corners[HIDDEN] = np.array([2.5, 7.5]) + rng.uniform(-2, 2, (3, 2))
    corners[POINT] = corners[POINT, :1]
    corners[AWAY] += 500
    colors = rng.random((COUNT, 3 if "corners" in effects else 1, 4 if "alpha" in effects else 3))
    colors[COVER, :, 3:] = 1
    optional: dict[str, Any] = {
        "background": [0.2, 0.3, 0.4, 0.5][: 4 if "clear" in effects else 3]
    }
    if "texture" in effects:
        images = [rng.random((5, 3, 3)).astype(dtype), rng.random((8, 16, 3)).astype(dtype)]
        index = np.arange(COUNT, dtype=np.int32) % 3 - 1
        index[COVER] = -1
        uv = rng.uniform(-0.5, 1.5, (COUNT, 3, 2))
        optional |= {"textures": sr.TexturePyramid.build(images), "texture_index": index, "uv": uv}
    if "depth" in effects:
        depth = rng.random((COUNT, 3))
        depth[COVER], depth[HIDDEN] = 1.5, 2
        optional["depth"] = depth
    if "perspective" in effects:
        optional["inverse_w"] = rng.uniform(0.5, 1.5, (COUNT, 3))
    return sr.Scene.from_soup(corners.astype(dtype), colors, **optional)


def plan_of(mode: str, scenes: Any) -> sr.Plan:
    return sr.plan(scenes, height=SIZE, width=SIZE, coverage=MODES[mode].coverage)


def direction_of(scene: sr.Scene, name: str, seed: int) -> Any:
    """A seeded direction in one input, zero in the others."""
    rng = np.random.default_rng(seed)
    return eqx.tree_at(
        lambda s: getattr(s, name),
        jax.tree.map(jnp.zeros_like, float_leaves(scene)),
        jax.tree.map(
            lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype),
            getattr(float_leaves(scene), name),
        ),
    )


class Found(NamedTuple):
    """What a program finds of a scene, and what it was asked: a direction of each input, a weight.

    The products are in the order of `Mode.inputs`.
    """

    scene: sr.Scene
    plan: sr.Plan
    directions: Any
    weight: Any
    products: Products

    def of(self, name: str, mode: str) -> tuple[Any, Any, Any]:
        """An input's direction, the image's tangent along it, and its part of the gradient."""
        at = MODES[mode].inputs.index(name)
        own = jax.tree.map(lambda leaf: leaf[at], getattr(self.directions, name))
        return own, self.products.tangents[at], getattr(self.products.gradient, name)


def asked(mode: str, scene: sr.Scene) -> tuple[Any, Any, Any]:
    """A direction for each input, stacked; a weight of the image; and pixels to keep: all."""
    directions = [direction_of(scene, name, seed) for seed, name in enumerate(MODES[mode].inputs)]
    shape = (SIZE, SIZE, scene.background.shape[0])
    dtype = scene.positions.dtype
    weight = weight_of(jax.ShapeDtypeStruct(shape, dtype), seed=99)
    return stack(directions), weight, jnp.ones(shape[:2], dtype)


@functools.cache
def found(mode: str, dtype: type = np.float32) -> Found:
    """One program serves all rows of a mode."""
    scene = scene_of(MODES[mode].effects, dtype)
    plan = plan_of(mode, scene)
    directions, weight, kept = asked(mode, scene)
    return Found(scene, plan, directions, weight, products(scene, plan, directions, weight, kept))


def assert_adjoint(row: Found, name: str, mode: str, tolerance: float) -> None:
    """The dot-product test, relative to the norms."""
    direction, tangent, own = row.of(name, mode)
    norm = (inner(own, own) * inner(direction, direction)) ** 0.5
    assert abs(inner(row.weight, tangent) - inner(own, direction)) <= tolerance * norm


@pytest.mark.parametrize("mode, name", rows())
def test_both_directions_agree(mode, name):
    row = found(mode)
    assert not row.products.overflow
    assert_adjoint(row, name, mode, 1e-5)
    # Something moves, unless nothing may.
    assert (np.abs(row.of(name, mode)[1]).max() > 1e-3) == (name not in MODES[mode].zero)


@pytest.mark.slow
@pytest.mark.parametrize("mode, name", rows(RICHEST))
def test_both_directions_agree_in_float64(mode, name, float64):
    assert_adjoint(found(mode, np.float64), name, mode, 1e-10)


@pytest.mark.parametrize("mode, name", rows())
def test_finite(mode, name):
    row = found(mode)
    assert is_finite((row.products.image, *row.of(name, mode)))


@pytest.mark.parametrize("mode, name", rows())
def test_zero_where_it_must_be(mode, name):
    row = found(mode)
    _, tangent, own = row.of(name, mode)
    if name in MODES[mode].zero:
        assert not np.asarray(tangent).any()
        assert not np.asarray(own).any()
    if name in ("background", "textures"):
        return
    per_vertex = name in ("positions", "depth", "inverse_w")
    own = np.asarray(own).reshape(COUNT, -1) if per_vertex else np.asarray(own)
    assert not own[AWAY].any()
    if MODES[mode].hides:
        assert not own[HIDDEN].any()
    if name == "uv":
        assert not own[np.asarray(row.scene.texture_index) < 0].any()


def assert_near(found: Any, wanted: Any, tolerance: float = 2e-5) -> None:
    """Relative to the greatest number of each array."""
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        scale = max(1.0, float(np.abs(b).max(initial=0)))
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


def parts(found: Products) -> Any:
    return found.image, found.tangents, found.gradient, found.normal


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_jit_is_eager(mode):
    """Nothing compiled as a whole, and `jax.jvp` and `jax.vjp` where the program linearizes."""
    row = found(mode)
    floats, rest = eqx.partition(row.scene, eqx.is_inexact_array)

    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), row.plan)[0]

    drawn, pull = jax.vjp(image, floats)
    assert_near(drawn, row.products.image)
    assert_near(pull(row.weight)[0], row.products.gradient)
    everywhere = jax.tree.map(lambda leaf: leaf.sum(0), row.directions)
    tangent = jax.jvp(image, (floats,), (everywhere,))[1]
    assert_near(tangent, row.products.tangents.sum(0))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft", "area"])
def test_vmap_is_a_loop(mode):
    scenes = [scene_of(MODES[mode].effects, seed=seed) for seed in range(3)]
    plan = plan_of(mode, scenes)
    given = asked(mode, scenes[0])
    floats, rest = zip(
        *(eqx.partition(scene, eqx.is_inexact_array) for scene in scenes), strict=True
    )
    batch = jax.vmap(lambda floats: parts(products(eqx.combine(floats, rest[0]), plan, *given)))(
        stack(floats)
    )
    for number, scene in enumerate(scenes):
        alone = parts(products(scene, plan, *given))
        assert_near(jax.tree.map(lambda entry, at=number: entry[at], batch), alone)


TRANSFORMATIONS = {
    "grad of vmap": lambda draw, x, v: jax.grad(lambda x: (jax.vmap(draw)(x) ** 2).mean())(x),
    "vmap of grad": lambda draw, x, v: jax.vmap(jax.grad(lambda x: (draw(x) ** 2).mean()))(x),
    "jvp of vmap": lambda draw, x, v: jax.jvp(jax.vmap(draw), (x,), (v,))[1],
    "linearize of vmap": lambda draw, x, v: jax.linearize(jax.vmap(draw), x)[1](v),
    "vjp of vmap": lambda draw, x, v: jax.vjp(jax.vmap(draw), x)[1](jax.vmap(draw)(x))[0],
}
"""Of a function that draws one scene from one of its inputs, a batch of these, and a tangent."""


def batch_of(mode: str, name: str) -> tuple[Any, Any, Any]:
    """A function that draws, a batch of inputs for it, and a direction of each."""
    scenes = [scene_of(MODES[mode].effects, seed=seed) for seed in range(2)]
    plan = plan_of(mode, scenes)
    fixed = scenes[0]

    def draw(value: Any) -> Any:
        scene = eqx.tree_at(lambda s: getattr(s, name), fixed, eqx.combine(value, rest))
        return sr.render_checked(scene, plan)[0]

    rest = eqx.filter(getattr(fixed, name), eqx.is_inexact_array, inverse=True)
    batch = stack([eqx.filter(getattr(s, name), eqx.is_inexact_array) for s in scenes])
    return draw, batch, jax.tree.map(jnp.ones_like, batch)


@pytest.mark.parametrize("mode, name", rows())
def test_every_transformation_of_a_batch_traces(mode, name):
    """Traced, not run: JAX refuses some nestings of derivatives and batches when it traces them."""
    draw, batch, direction = batch_of(mode, name)
    for transformation in TRANSFORMATIONS.values():
        for program in (transformation, jax.jit(transformation, static_argnums=0)):
            jax.eval_shape(lambda x, v, p=program: p(draw, x, v), batch, direction)


@pytest.mark.parametrize(
    "mode",
    [mode if mode in QUICK else pytest.param(mode, marks=pytest.mark.slow) for mode in MODES],
)
def test_gradients_of_a_batch_are_those_of_its_scenes(mode):
    """The batch in one derivative, against one derivative for each scene."""
    draw, batch, direction = batch_of(mode, "positions")
    count = len(jax.tree.leaves(batch)[0])
    slope = jax.jit(jax.grad(lambda x: (draw(x) ** 2).mean() / count))
    alone = stack([slope(batch[number]) for number in range(count)])
    for name in ("grad of vmap", "jvp of vmap"):
        found = jax.jit(TRANSFORMATIONS[name], static_argnums=0)(draw, batch, direction)
        if name == "grad of vmap":
            assert_near(found, alone, 1e-6)
        else:
            moved = jax.jit(lambda x, v: jax.jvp(draw, (x,), (v,))[1])
            assert_near(found, stack([moved(x, v) for x, v in zip(batch, direction, strict=True)]))


def image_by_positions(row: Found):
    return lambda positions: sr.render_checked(replace(row.scene, positions=positions), row.plan)[0]


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["soft", "area"])
def test_hessian_vector_products(mode, float64):
    """Symmetric, and the differences of gradients."""
    row = found(mode, np.float64)
    image = image_by_positions(row)
    slope = jax.grad(lambda positions: jnp.sum(row.weight * image(positions) ** 2))
    curve = jax.jit(lambda x, v: jax.jvp(slope, (x,), (v,))[1])
    slope = jax.jit(slope)
    rng, at = np.random.default_rng(3), row.scene.positions
    # A triangle without area is a bend.
    still = np.ones((COUNT, 3, 1))
    still[POINT] = 0
    u, v = (jnp.asarray((still * rng.normal(size=(COUNT, 3, 2))).reshape(-1, 2)) for _ in "uv")
    bent = curve(at, v)
    assert is_finite(bent)
    moved = still.reshape(-1, 1)
    assert inner(u, bent) == pytest.approx(inner(v, curve(at, u)), rel=1e-9, abs=1e-9)
    step = 1e-7
    difference = (slope(at + step * v) - slope(at - step * v)) / (2 * step)
    assert_near(moved * bent, moved * difference, 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_lineax_operators(mode):
    row = found(mode)
    image = image_by_positions(row)
    operator = lx.JacobianLinearOperator(lambda x, _: image(x), row.scene.positions)
    direction, tangent, gradient = row.of("positions", mode)
    assert_near(operator.mv(direction), tangent)
    assert_near(operator.T.mv(row.weight), gradient)
