"""A program contains only the effects of its scene: opaque flat scenes do not blend or interpolate.

The effects of a compiled program (texture, depth test, transmittance) are read from the scopes of
its instructions. Its arithmetic is read from the traced program, in which every value that derives
from colours or from positions is marked, beginning with the inputs. Blending multiplies two values
that derive from colours (a colour and a transmittance). Interpolation multiplies a value that
derives from colours by a value that derives from positions (a weight). A flat scene multiplies
colours by counts of samples. Counts are not marked, because they derive from decisions (whether a
sample is covered), and a decision passes on no marks.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

import softras2d as sr
from softras2d.rendering.render import compile_render

from .cases.scenes import colors_of

COUNT = 24
COLORS, POSITIONS = 1, 2
Marks = list[int]
"""What each of a list of values derives from: the sum of `COLORS` and `POSITIONS`."""


def _program(channels: int, corners: int, background: int = 3) -> tuple[ClosedJaxpr, Marks]:
    """The traced `render`, and the marks of its inputs."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 32, (COUNT, 3, 2)).astype(np.float32)
    scene = sr.Scene.from_soup(
        points, colors_of(COUNT, channels, corners), background=[0.5] * background
    )
    plan = sr.plan(scene, height=32, width=32, coverage=sr.Hard(samples=16))
    program = jax.make_jaxpr(sr.render_checked)(scene, plan)
    kinds = {id(scene.colors): COLORS, id(scene.positions): POSITIONS}
    marks = [kinds.get(id(leaf), 0) for leaf in jax.tree.leaves((scene, plan))]
    assert sorted(filter(None, marks)) == [COLORS, POSITIONS]
    return program, marks


def _inner(eqn: JaxprEqn) -> Iterator[Jaxpr]:
    for value in eqn.params.values():
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, ClosedJaxpr):
                yield item.jaxpr
            elif isinstance(item, Jaxpr):
                yield item


def _equations(jaxpr: Jaxpr) -> Iterator[JaxprEqn]:
    """All equations, including those in loops, branches and calls."""
    for eqn in jaxpr.eqns:
        yield eqn
        for inner in _inner(eqn):
            yield from _equations(inner)


_VALUES = {
    "gather": [0],
    "dynamic_slice": [0],
    "dynamic_update_slice": [0, 1],
    "scatter": [0, 2],
    "scatter-add": [0, 2],
    "select_n": [1, 2],
    **{name: [] for name in ("population_count", "and", "or", "xor", "not")},
}
"""For some operations, the operands that pass on marks; indices, conditions and bits do not."""


class _Products:
    """The products in a program, and how many of them are blending or interpolation."""

    def __init__(self, program: ClosedJaxpr, marks: Marks):
        self.factors: dict[int, Marks] = {}
        self._follow(program.jaxpr, marks)
        pairs = [sorted(pair) for pair in self.factors.values()]
        self.blending = sum(bool(a & b & COLORS) for a, b in pairs)
        self.interpolation = sum(
            bool((a & COLORS and b & POSITIONS) or (a & POSITIONS and b & COLORS)) for a, b in pairs
        )

    def _follow(self, jaxpr: Jaxpr, marks: Marks) -> Marks:
        """The marks of the outputs."""
        known: dict[Any, int] = dict(zip(jaxpr.invars, marks, strict=True))

        def mark(var: Any) -> int:
            return 0 if isinstance(var, Literal) else known.get(var, 0)

        for eqn in jaxpr.eqns:
            operands = [mark(var) for var in eqn.invars]
            if not any(operands):
                continue
            if eqn.primitive.name in ("mul", "div", "dot_general"):
                before = self.factors.get(id(eqn), [0, 0])
                self.factors[id(eqn)] = _either(before, operands)
            for var, derived in zip(
                eqn.outvars, self._marks_of_outputs(eqn, operands), strict=True
            ):
                decision = getattr(var.aval, "dtype", None) == np.bool_
                known[var] = 0 if decision else derived
        return [mark(var) for var in jaxpr.outvars]

    def _marks_of_outputs(self, eqn: JaxprEqn, operands: Marks) -> Marks:
        """The marks of the outputs of one equation."""
        name, params = eqn.primitive.name, eqn.params
        if name == "while":
            first, second = params["cond_nconsts"], params["body_nconsts"]
            constants, carry = operands[first : first + second], operands[first + second :]
            return self._loop(params["body_jaxpr"].jaxpr, constants, carry, [])
        if name == "scan":
            first, second = params["num_consts"], params["num_carry"]
            constants, carry, scanned = (
                operands[:first],
                operands[first:][:second],
                operands[first + second :],
            )
            return self._loop(params["jaxpr"].jaxpr, constants, carry, scanned)
        if name == "cond":
            outs = [self._follow(branch.jaxpr, operands[1:]) for branch in params["branches"]]
            return [int(np.bitwise_or.reduce(column)) for column in zip(*outs, strict=True)]
        inner = list(_inner(eqn))
        if len(inner) == 1 and len(inner[0].invars) == len(operands):
            return self._follow(inner[0], operands)
        if name == "sort":
            return operands
        used = [operands[i] for i in _VALUES[name]] if name in _VALUES else operands
        return [int(np.bitwise_or.reduce([0, *used]))] * len(eqn.outvars)

    def _loop(self, body: Jaxpr, constants: Marks, carry: Marks, scanned: Marks) -> Marks:
        """The marks of a loop's outputs, iterated until they no longer grow."""
        while True:
            out = self._follow(body, constants + carry + scanned)
            new = _either(carry, out[: len(carry)])
            if new == carry:
                return out
            carry = new


def _either(first: Marks, second: Marks) -> Marks:
    return [a | b for a, b in zip(first, second, strict=True)]


def test_an_opaque_flat_scene_neither_blends_nor_interpolates():
    products = _Products(*_program(channels=3, corners=1))
    assert len(products.factors) > 0
    assert products.blending == 0
    assert products.interpolation == 0


@pytest.mark.parametrize("channels", [3, 4])
def test_corner_colors_interpolate_and_blend_only_with_alpha(channels):
    """The search recognizes interpolation and blending, and opaque scenes never blend."""
    products = _Products(*_program(channels, corners=3))
    assert products.interpolation > 0
    assert (products.blending > 0) == (channels == 4)


def test_a_translucent_flat_scene_blends():
    assert _Products(*_program(channels=4, corners=1)).blending > 0


@pytest.mark.parametrize("corners", [1, 3])
def test_a_transparent_background_blends_no_triangles(corners):
    """Over a background with alpha, the image is divided by alpha once."""
    products = _Products(*_program(channels=3, corners=corners, background=4))
    assert products.blending <= 1


@pytest.mark.parametrize("corners", [1, 3])
@pytest.mark.parametrize("channels", [3, 4])
def test_no_number_takes_64_bits(channels, corners):
    """All numbers are as under `jit` without 64-bit types."""
    program, _ = _program(channels, corners)
    for eqn in _equations(program.jaxpr):
        for var in eqn.outvars:
            dtype = getattr(var.aval, "dtype", np.bool_)
            if np.issubdtype(dtype, np.number):
                assert np.dtype(dtype).itemsize <= 4


SCOPES = ("texture", "depth_test", "transmittance")
"""Scopes in which instructions of an effect are traced, and which the compiler keeps."""


def _scopes(scene: sr.Scene) -> set[str]:
    """The `SCOPES` that name an instruction of the compiled program."""
    plan = sr.plan(scene, height=24, width=24, coverage=sr.Hard(samples=4))
    text = compile_render(scene, plan).compiled.as_text()
    return {scope for scope in SCOPES if f"/{scope}/" in text}


@pytest.mark.parametrize(
    "present",
    [(), ("texture",), ("depth_test",), ("transmittance",), SCOPES],
    ids=lambda present: "+".join(present) or "none",
)
def test_a_program_has_exactly_the_effects_of_its_scene(present):
    """No texel, depth or transmittance is computed for a scene without them."""
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 24, (8, 3, 2)).astype(np.float32)
    effects = {}
    if "texture" in present:
        image = rng.random((5, 4, 3)).astype(np.float32)
        effects["textures"] = sr.TexturePyramid.build([image])
        effects["texture_index"] = np.zeros(8, np.int32)
        effects["uv"] = rng.random((8, 3, 2)).astype(np.float32)
    if "depth_test" in present:
        effects["depth"] = rng.random((8, 3)).astype(np.float32)
    channels = 4 if "transmittance" in present else 3
    assert _scopes(sr.Scene.from_soup(points, colors_of(8, channels), **effects)) == set(present)
