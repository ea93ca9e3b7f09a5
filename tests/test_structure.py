"""A scene pays for what it shows: an opaque flat one neither blends nor interpolates.

Read from the traced program. Values that derive from the colours are followed through it: blending
multiplies two of them (transmittance and colour), interpolation multiplies one by weights and so
takes more products than the resolve of a flat scene.
"""

from collections.abc import Iterator

import jax
import numpy as np
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

import softras2d as sr

from .cases import colors_of

COUNT = 24
PRODUCTS = ("mul", "dot_general", "div")


def _program(channels: int, corners: int, background: int = 3) -> tuple[ClosedJaxpr, list[bool]]:
    """The traced `render`, and which of its inputs are colours."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 32, (COUNT, 3, 2)).astype(np.float32)
    scene = sr.Scene.from_soup(
        points, colors_of(COUNT, channels, corners), background=[0.5] * background
    )
    plan = sr.plan(scene, height=32, width=32, coverage=sr.Hard(samples=16))
    program = jax.make_jaxpr(sr.render_checked)(scene, plan)
    tinted = [leaf is scene.colors for leaf in jax.tree.leaves((scene, plan))]
    assert sum(tinted) == 1
    return program, tinted


def _inner(eqn: JaxprEqn) -> Iterator[Jaxpr]:
    for value in eqn.params.values():
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, ClosedJaxpr):
                yield item.jaxpr
            elif isinstance(item, Jaxpr):
                yield item


def _equations(jaxpr: Jaxpr) -> Iterator[JaxprEqn]:
    """All equations, those of loops, branches and calls included."""
    for eqn in jaxpr.eqns:
        yield eqn
        for inner in _inner(eqn):
            yield from _equations(inner)


def _products(program: ClosedJaxpr, tinted: list[bool]) -> tuple[int, int]:
    """How many products take one factor that derives from the colours, and how many take two."""
    one, two = set(), set()
    _follow(program.jaxpr, tinted, one, two)
    return len(one), len(two)


def _follow(jaxpr: Jaxpr, tinted: list[bool], one: set, two: set) -> list[bool]:
    """Which outputs derive from the tinted inputs; products are collected by identity."""
    assert len(jaxpr.invars) == len(tinted)
    known = {var for var, mark in zip(jaxpr.invars, tinted, strict=True) if mark}
    for eqn in jaxpr.eqns:
        marks = [not isinstance(v, Literal) and v in known for v in eqn.invars]
        if not any(marks):
            continue
        if eqn.primitive.name in PRODUCTS:
            (two if sum(marks) == 2 else one).add(id(eqn))
        known.update(
            var
            for var, mark in zip(eqn.outvars, _through(eqn, marks, one, two), strict=True)
            if mark
        )
    return [not isinstance(v, Literal) and v in known for v in jaxpr.outvars]


def _through(eqn: JaxprEqn, marks: list[bool], one: set, two: set) -> list[bool]:
    """Tints of the outputs of an equation: through what it calls, else all floats."""
    name, params = eqn.primitive.name, eqn.params
    if name == "while":
        constants, rest = params["cond_nconsts"], params["body_nconsts"]
        body, carry = marks[constants : constants + rest], marks[constants + rest :]
        while True:  # until no more of the carry is tinted
            out = _follow(params["body_jaxpr"].jaxpr, body + carry, one, two)
            new = [a or b for a, b in zip(carry, out, strict=True)]
            if new == carry:
                return carry
            carry = new
    if name == "scan":
        constants, size = params["num_consts"], params["num_carry"]
        fixed, carry, rest = marks[:constants], marks[constants:][:size], marks[constants + size :]
        while True:
            out = _follow(params["jaxpr"].jaxpr, fixed + carry + rest, one, two)
            new = [a or b for a, b in zip(carry, out[:size], strict=True)]
            if new == carry:
                return out
            carry = new
    if name == "cond":
        outs = [_follow(branch.jaxpr, marks[1:], one, two) for branch in params["branches"]]
        return [any(column) for column in zip(*outs, strict=True)]
    inner = list(_inner(eqn))
    if len(inner) == 1 and len(inner[0].invars) == len(marks):
        return _follow(inner[0], marks, one, two)
    return [np.issubdtype(getattr(v.aval, "dtype", np.bool_), np.floating) for v in eqn.outvars]


def test_opaque_flat_blends_nothing():
    _, blended = _products(*_program(channels=3, corners=1))
    assert blended == 0
    # The same search finds the blending where it is.
    _, blended = _products(*_program(channels=4, corners=1))
    assert blended > 0


def test_opaque_flat_interpolates_nothing():
    flat, _ = _products(*_program(channels=3, corners=1))
    # Counts of samples times colour, and at most one scale for the mean.
    assert flat <= 2
    interpolated, _ = _products(*_program(channels=3, corners=3))
    assert interpolated > flat


@pytest.mark.parametrize("channels, corners, background", [(3, 3, 3), (4, 1, 3), (3, 1, 4)])
def test_effects_add_equations(channels, corners, background):
    simple, _ = _program(3, 1, 3)
    rich, _ = _program(channels, corners, background)
    assert sum(1 for _ in _equations(simple.jaxpr)) < sum(1 for _ in _equations(rich.jaxpr))


@pytest.mark.parametrize("corners", [1, 3])
@pytest.mark.parametrize("channels", [3, 4])
def test_coverage_is_decided_in_32_bits_without_float64(channels, corners):
    """What a GPU and `jit` without x64 can hold: no 64-bit value anywhere."""
    program, _ = _program(channels, corners)
    for eqn in _equations(program.jaxpr):
        for var in eqn.outvars:
            dtype = getattr(var.aval, "dtype", None)
            if dtype is not None and np.issubdtype(dtype, np.number):
                assert np.dtype(dtype).itemsize <= 4
