"""Integers of every library are accepted; arguments of wrong types are refused in one line."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.arguments import check_type, checked_integer


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3), np.array(3), jnp.int32(3)])
def test_integers_of_every_library_become_pythons(value):
    count = checked_integer("count", value, 1, 3)
    assert type(count) is int and count == 3


@pytest.mark.parametrize("value", [0, True, np.True_, 2.0, np.float32(2), "2", None, [2]])
def test_anything_else_is_refused(value):
    with pytest.raises(ValueError) as caught:
        checked_integer("count", value, 1)
    assert str(caught.value) == f"`count` must be an integer of 1 or more; got {value!r}."


def test_a_range_is_named():
    with pytest.raises(ValueError, match=r"`count` must be an integer in 1\.\.8; got 9\."):
        checked_integer("count", 9, 1, 8)


def test_a_traced_integer_is_refused():
    with pytest.raises(ValueError, match="`count` must be an integer of 1 or more; got "):
        jax.jit(lambda count: checked_integer("count", count, 1))(2)


def test_a_wrong_type_is_named():
    check_type("plan", Path(), Path)
    with pytest.raises(ValueError) as caught:
        check_type("plan", None, Path, "plan_for(...)")
    assert str(caught.value) == "`plan` must be a Path, made by plan_for(...); got NoneType."


WRONG_TYPES = """
import numpy as np
import softras2d as sr

scene = sr.Scene.from_soup(np.zeros((1, 3, 2), np.float32), np.zeros((1, 3), np.float32))
plan = sr.plan(scene, height=8, width=8)
tiled = sr.plan_tiles(scene, height=32, width=32, tile=32, gradients=True)
gradient = sr.tiled_value_and_grad(lambda image, target: image.sum())
size = {"height": 8, "width": 8}
for call in (
    lambda: sr.render(scene, None),
    lambda: sr.render(None, plan),
    lambda: sr.render_checked(scene, tiled),
    lambda: sr.rasterize(scene, None),
    lambda: sr.pixel_layers(None, plan, layers=1),
    lambda: sr.check(None),
    lambda: sr.pad(None),
    lambda: sr.simplify(None, **size),
    lambda: sr.plan_tiles(None, **size),
    lambda: next(sr.render_tiles(scene, plan)),
    lambda: sr.write_tiles("a.png", None, tiled),
    lambda: gradient(scene, plan, np.zeros((32, 32))),
    lambda: gradient(scene, tiled, [[0.0] * 32] * 32),
    lambda: sr.write_svg("a.svg", None, **size),
    lambda: sr.write_svg_film("a.svg", [None], **size),
    lambda: sr.write_compact("a.s2d", None, **size),
):
    try:
        call()
    except ValueError as error:
        print(error)
"""


def test_wrong_arguments_of_public_functions_are_refused_in_one_line(tmp_path):
    """In a process of its own, without the type checks of the tests."""
    command = [sys.executable, "-c", WRONG_TYPES]
    lines = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=tmp_path
    ).stdout.splitlines()
    a_plan = "`plan` must be a Plan, made by softras2d.plan(scene, ...)"
    a_tiled_plan = "`plan` must be a TiledPlan, made by softras2d.plan_tiles(scene, ...)"
    a_scene = "`scene` must be a Scene; got NoneType."
    assert lines == [
        f"{a_plan}; got NoneType.",
        a_scene,
        f"{a_plan}; got TiledPlan.",
        f"{a_plan}; got NoneType.",
        *[a_scene] * 5,
        f"{a_tiled_plan}; got Plan.",
        a_scene,
        f"{a_tiled_plan}; got Plan.",
        "data must be arrays [32, 32, ...], as the canvas; got list.",
        a_scene,
        f"a.svg: frame 0: {a_scene}",
        a_scene,
    ]
