"""What every derivative must satisfy, for each coverage and each input that it draws.

jvp and vjp agree, every number is finite, `jit` and `vmap` change nothing, and what must be zero is
exactly zero. When a coverage learns to draw an effect, its entry of `MODES` gets one more word.
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

HIDDEN, COVERING, NO_AREA, OFF_CANVAS = range(4)
"""Indices of triangles: one hidden by the second, one without area, one off the canvas."""

COUNT = 10


class Mode(NamedTuple):
    """A coverage, the effects that it draws, and which of its derivatives are zero.

    - `effects`: words among `corners` (colours), `alpha`, `texture`, `depth`, `perspective`, and
      `clear` (a background of four channels).
    - `zero`: inputs whose derivative is zero.
    - `hides`: whether a triangle hides what lies behind it. Blending by depth does not, since what
      lies deeper has a weight, however small; nor does a sum.
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
"""Modes whose effects include those of the others."""

QUICK = ("hard", "soft")
"""Modes that are tested in the quick run."""


def mode_input_pairs(modes: Any = tuple(MODES)) -> list[Any]:
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
    corners[COVERING] = [(7.7, -30), (7.2, 46), (-30, 8)]
    corners[HIDDEN] = np.array([2.5, 7.5]) + rng.uniform(-2, 2, (3, 2))
    corners[NO_AREA] = corners[NO_AREA, :1]
    corners[OFF_CANVAS] += 500
    colors = rng.random((COUNT, 3 if "corners" in effects else 1, 4 if "alpha" in effects else 3))
    colors[COVERING, :, 3:] = 1
    optional: dict[str, Any] = {
        "background": [0.2, 0.3, 0.4, 0.5][: 4 if "clear" in effects else 3]
    }
    if "texture" in effects:
        images = [rng.random((5, 3, 3)).astype(dtype), rng.random((8, 16, 3)).astype(dtype)]
        index = np.arange(COUNT, dtype=np.int32) % 3 - 1
        index[COVERING] = -1
        uv = rng.uniform(-0.5, 1.5, (COUNT, 3, 2))
        optional |= {"textures": sr.TexturePyramid.build(images), "texture_index": index, "uv": uv}
    if "depth" in effects:
        depth = rng.random((COUNT, 3))
        depth[COVERING], depth[HIDDEN] = 1.5, 2
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


class Derivatives(NamedTuple):
    """A scene, a direction of each input and a weight of the image, and the products with them.

    `directions` and `products` are in the order of `Mode.inputs`.
    """

    scene: sr.Scene
    plan: sr.Plan
    directions: Any
    weight: Any
    products: Products

    def by_input(self, name: str, mode: str) -> tuple[Any, Any, Any]:
        """An input's direction, the image's tangent along it, and the gradient by that input."""
        index = MODES[mode].inputs.index(name)
        direction = jax.tree.map(lambda leaf: leaf[index], getattr(self.directions, name))
        return direction, self.products.tangents[index], getattr(self.products.gradient, name)


def directions_and_weights(mode: str, scene: sr.Scene) -> tuple[Any, Any, Any]:
    """A direction for each input, stacked; a weight of the image; and 1 for each pixel."""
    directions = [direction_of(scene, name, seed) for seed, name in enumerate(MODES[mode].inputs)]
    shape = (SIZE, SIZE, scene.background.shape[0])
    dtype = scene.positions.dtype
    weight = weight_of(jax.ShapeDtypeStruct(shape, dtype), seed=99)
    return stack(directions), weight, jnp.ones(shape[:2], dtype)


@functools.cache
def derivatives_of(mode: str, dtype: type = np.float32) -> Derivatives:
    """The derivatives of a mode, computed once for all its inputs."""
    scene = scene_of(MODES[mode].effects, dtype)
    plan = plan_of(mode, scene)
    directions, weight, ones = directions_and_weights(mode, scene)
    return Derivatives(
        scene, plan, directions, weight, products(scene, plan, directions, weight, ones)
    )


def assert_adjoint(derivatives: Derivatives, name: str, mode: str, tolerance: float) -> None:
    """Assert that `w . J v` and `J^T w . v` agree, relative to the norms."""
    direction, tangent, gradient = derivatives.by_input(name, mode)
    norm = (inner(gradient, gradient) * inner(direction, direction)) ** 0.5
    assert abs(inner(derivatives.weight, tangent) - inner(gradient, direction)) <= tolerance * norm


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_jvp_and_vjp_agree(mode, name):
    derivatives = derivatives_of(mode)
    assert not derivatives.products.overflow
    assert_adjoint(derivatives, name, mode, 1e-5)
    # The tangent is not zero, except for inputs named in `zero`.
    assert (np.abs(derivatives.by_input(name, mode)[1]).max() > 1e-3) == (
        name not in MODES[mode].zero
    )


@pytest.mark.slow
@pytest.mark.parametrize("mode, name", mode_input_pairs(RICHEST))
def test_jvp_and_vjp_agree_in_float64(mode, name, float64):
    assert_adjoint(derivatives_of(mode, np.float64), name, mode, 1e-10)


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_image_and_derivatives_are_finite(mode, name):
    derivatives = derivatives_of(mode)
    assert is_finite((derivatives.products.image, *derivatives.by_input(name, mode)))


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_derivatives_by_what_cannot_matter_are_zero(mode, name):
    derivatives = derivatives_of(mode)
    _, tangent, gradient = derivatives.by_input(name, mode)
    if name in MODES[mode].zero:
        assert not np.asarray(tangent).any()
        assert not np.asarray(gradient).any()
    if name in ("background", "textures"):
        return
    per_vertex = name in ("positions", "depth", "inverse_w")
    gradient = np.asarray(gradient).reshape(COUNT, -1) if per_vertex else np.asarray(gradient)
    assert not gradient[OFF_CANVAS].any()
    if MODES[mode].hides:
        assert not gradient[HIDDEN].any()
    if name == "uv":
        assert not gradient[np.asarray(derivatives.scene.texture_index) < 0].any()


def assert_near(actual: Any, expected: Any, tolerance: float = 2e-5) -> None:
    """Assert closeness, relative to the greatest number of each array."""
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        scale = max(1.0, float(np.abs(b).max(initial=0)))
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


def outputs(result: Products) -> Any:
    return result.image, result.tangents, result.gradient, result.normal


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_jit_changes_nothing(mode):
    """Also with `jax.jvp` and `jax.vjp` in place of `jax.linearize` and its transpose."""
    derivatives = derivatives_of(mode)
    floats, rest = eqx.partition(derivatives.scene, eqx.is_inexact_array)

    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), derivatives.plan)[0]

    image_without_jit, vjp = jax.vjp(image, floats)
    assert_near(image_without_jit, derivatives.products.image)
    assert_near(vjp(derivatives.weight)[0], derivatives.products.gradient)
    direction = jax.tree.map(lambda leaf: leaf.sum(0), derivatives.directions)
    tangent = jax.jvp(image, (floats,), (direction,))[1]
    assert_near(tangent, derivatives.products.tangents.sum(0))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft", "area"])
def test_vmap_equals_a_loop(mode):
    scenes = [scene_of(MODES[mode].effects, seed=seed) for seed in range(3)]
    plan = plan_of(mode, scenes)
    inputs = directions_and_weights(mode, scenes[0])
    floats, rest = zip(
        *(eqx.partition(scene, eqx.is_inexact_array) for scene in scenes), strict=True
    )
    batch = jax.vmap(lambda floats: outputs(products(eqx.combine(floats, rest[0]), plan, *inputs)))(
        stack(floats)
    )
    for number, scene in enumerate(scenes):
        expected = outputs(products(scene, plan, *inputs))
        assert_near(jax.tree.map(lambda entry, at=number: entry[at], batch), expected)


TRANSFORMATIONS = {
    "grad of vmap": lambda draw, x, v: jax.grad(lambda x: (jax.vmap(draw)(x) ** 2).mean())(x),
    "vmap of grad": lambda draw, x, v: jax.vmap(jax.grad(lambda x: (draw(x) ** 2).mean()))(x),
    "jvp of vmap": lambda draw, x, v: jax.jvp(jax.vmap(draw), (x,), (v,))[1],
    "linearize of vmap": lambda draw, x, v: jax.linearize(jax.vmap(draw), x)[1](v),
    "vjp of vmap": lambda draw, x, v: jax.vjp(jax.vmap(draw), x)[1](jax.vmap(draw)(x))[0],
}
"""Transformations of a function that draws a scene from one input, of a batch `x`, tangent `v`."""


def batch_of(mode: str, name: str, dtype: type = np.float32) -> tuple[Any, Any, Any]:
    """A function that draws a scene from one input, a batch of inputs, and a direction of each."""
    scenes = [scene_of(MODES[mode].effects, dtype, seed=seed) for seed in range(2)]
    plan = plan_of(mode, scenes)
    fixed = scenes[0]

    def draw(value: Any) -> Any:
        scene = eqx.tree_at(lambda s: getattr(s, name), fixed, eqx.combine(value, rest))
        return sr.render_checked(scene, plan)[0]

    rest = eqx.filter(getattr(fixed, name), eqx.is_inexact_array, inverse=True)
    batch = stack([eqx.filter(getattr(s, name), eqx.is_inexact_array) for s in scenes])
    return draw, batch, jax.tree.map(jnp.ones_like, batch)


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_every_transformation_of_a_batch_traces(mode, name):
    """Only traced, not run: JAX refuses some nestings of derivatives and batches when tracing."""
    draw, batch, direction = batch_of(mode, name)
    for transformation in TRANSFORMATIONS.values():
        for program in (transformation, jax.jit(transformation, static_argnums=0)):
            jax.eval_shape(lambda x, v, p=program: p(draw, x, v), batch, direction)


def assert_batch_equals_loop(mode: str, dtype: type, tolerance: float) -> None:
    """Compare the derivatives of a batch with those of each of its scenes alone."""
    draw, batch, direction = batch_of(mode, "positions", dtype)
    count = len(jax.tree.leaves(batch)[0])
    gradient = jax.jit(jax.grad(lambda x: (draw(x) ** 2).mean() / count))
    tangent = jax.jit(lambda x, v: jax.jvp(draw, (x,), (v,))[1])
    of_scenes = {
        "grad of vmap": stack([gradient(x) for x in batch]),
        "jvp of vmap": stack([tangent(x, v) for x, v in zip(batch, direction, strict=True)]),
    }
    for name, expected in of_scenes.items():
        of_batch = jax.jit(TRANSFORMATIONS[name], static_argnums=0)(draw, batch, direction)
        assert_near(of_batch, expected, tolerance * (0.05 if name == "grad of vmap" else 1))


def test_derivatives_of_a_batch_are_those_of_its_scenes():
    assert_batch_equals_loop("hard", np.float32, 2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_derivatives_of_a_batch_are_those_of_its_scenes_in_float64(mode, float64):
    """In float64, so that the bound does not depend on how thin the triangles are."""
    assert_batch_equals_loop(mode, np.float64, 1e-11)


def image_by_positions(derivatives: Derivatives):
    return lambda positions: sr.render_checked(
        replace(derivatives.scene, positions=positions), derivatives.plan
    )[0]


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["soft", "area"])
def test_hessian_vector_products_are_those_of_the_gradient(mode, float64):
    """They are symmetric, and equal the differences of gradients."""
    derivatives = derivatives_of(mode, np.float64)
    image = image_by_positions(derivatives)
    gradient = jax.grad(lambda positions: jnp.sum(derivatives.weight * image(positions) ** 2))
    hessian_product = jax.jit(lambda x, v: jax.jvp(gradient, (x,), (v,))[1])
    gradient = jax.jit(gradient)
    rng, positions = np.random.default_rng(3), derivatives.scene.positions
    # The derivative jumps at a triangle without area, which is left out.
    is_smooth = np.ones((COUNT, 3, 1))
    is_smooth[NO_AREA] = 0
    u, v = (jnp.asarray((is_smooth * rng.normal(size=(COUNT, 3, 2))).reshape(-1, 2)) for _ in "uv")
    product = hessian_product(positions, v)
    assert is_finite(product)
    mask = is_smooth.reshape(-1, 1)
    assert inner(u, product) == pytest.approx(
        inner(v, hessian_product(positions, u)), rel=1e-9, abs=1e-9
    )
    step = 1e-7
    difference = (gradient(positions + step * v) - gradient(positions - step * v)) / (2 * step)
    assert_near(mask * product, mask * difference, 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_lineax_operators_give_the_same_products(mode):
    derivatives = derivatives_of(mode)
    image = image_by_positions(derivatives)
    operator = lx.JacobianLinearOperator(lambda x, _: image(x), derivatives.scene.positions)
    direction, tangent, gradient = derivatives.by_input("positions", mode)
    assert_near(operator.mv(direction), tangent)
    assert_near(operator.T.mv(derivatives.weight), gradient)
