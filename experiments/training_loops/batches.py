"""Time the gradient of a batch by `vmap`, `lax.map`, a loop, and a dense rasterizer."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softras2d as sr

from ..common.timing import interleave
from . import dense
from .lasting import COVERAGES, scene_of

KINDS = {"8 triangles, 28 px": (8, 28), "30, 64 px": (30, 64), "30, 128 px": (30, 128)}
"""Triangles and side of the canvas, by the name in the tables."""

BATCH, BATCHES, SEED = 16, (1, 4, 16, 64), 0
VMAP, MAP, LOOP, DENSE, DENSE_MAP = "vmap", "lax.map", "loop", "dense, vmap", "dense, lax.map"

Draw = Callable[[Array, Array], Array]
"""A function that maps the corners and colours of one scene to its image."""


def batch_of(
    count: int, triangles: int, size: int
) -> tuple[Float[Array, "batch triangles 3 2"], Float[Array, "batch triangles 3"]]:
    """Corners and colours of random scenes, with sides of about a quarter of the canvas."""
    rng = np.random.default_rng(SEED)
    centre = rng.uniform(0, size, (count, triangles, 1, 2))
    corners = centre + rng.normal(size=(count, triangles, 3, 2)) * (size / 8)
    colors = rng.random((count, triangles, 3))
    return jnp.asarray(corners, jnp.float32), jnp.asarray(colors, jnp.float32)


def draw_with(plan: sr.Plan, corners: Array, colors: Array) -> Array:
    return sr.render(scene_of(corners, colors), plan)


def gradient_of(draw: Draw, target: Array, over_batch: Callable[..., Any]) -> Callable[..., Any]:
    """Compile the mean squared error of a batch and its gradient with respect to inputs.

    `over_batch(draw, corners, colors)` returns the images of the batch.
    """

    def loss(corners: Array, colors: Array) -> Array:
        return jnp.mean((over_batch(draw, corners, colors) - target) ** 2)

    return jax.jit(jax.value_and_grad(loss, (0, 1)))


def by_vmap(draw: Draw, corners: Array, colors: Array) -> Array:
    return jax.vmap(draw)(corners, colors)


def by_map(draw: Draw, corners: Array, colors: Array) -> Array:
    return jax.lax.map(lambda scene: draw(*scene), (corners, colors))


def by_itself(draw: Draw, corners: Array, colors: Array) -> Array:
    return draw(corners, colors)


def call_of(gradient: Callable[..., Any], *arguments: Array) -> Callable[[], object]:
    return lambda: jax.block_until_ready(gradient(*arguments))


def loop_of(gradient: Callable[..., Any], corners: Array, colors: Array) -> Callable[[], object]:
    """A Python loop over the scenes, with one compiled gradient of a single scene."""
    scenes = [(corners[i], colors[i]) for i in range(corners.shape[0])]
    return lambda: jax.block_until_ready([gradient(*scene) for scene in scenes])


def target_of(size: int) -> Float[Array, "size size 3"]:
    """The target image: white noise in 0..1."""
    return jnp.asarray(np.random.default_rng(1).random((size, size, 3)), jnp.float32)


def dense_draw(size: int) -> Draw:
    return partial(dense.render, size=size, width=1.0)


def compare_ways(kind: str, budget_s: float) -> list[dict[str, Any]]:
    """One row for each coverage and method of drawing `BATCH` scenes, all timed in turn."""
    triangles, size = KINDS[kind]
    corners, colors = batch_of(BATCH, triangles, size)
    target = target_of(size)
    calls: dict[tuple[str, str], Callable[[], object]] = {}
    for name, coverage in COVERAGES.items():
        plan = sr.plan_for(triangles=triangles, height=size, width=size, coverage=coverage)
        draw = partial(draw_with, plan)
        for way, over_batch in ((VMAP, by_vmap), (MAP, by_map)):
            calls[name, way] = call_of(gradient_of(draw, target, over_batch), corners, colors)
        calls[name, LOOP] = loop_of(gradient_of(draw, target, by_itself), corners, colors)
    for way, over_batch in ((DENSE, by_vmap), (DENSE_MAP, by_map)):
        gradient = gradient_of(dense_draw(size), target, over_batch)
        calls["dense", way] = call_of(gradient, corners, colors)
    times = interleave({"|".join(key): call for key, call in calls.items()}, budget_s=budget_s)
    return [
        {
            "scene": kind,
            "batch": BATCH,
            "coverage": name,
            "way": way,
            "ms": times[f"{name}|{way}"].median,
            "least_ms": times[f"{name}|{way}"].least,
            "cpu_ms": times[f"{name}|{way}"].cpu,
        }
        for name, way in calls
    ]


def grow(kind: str, budget_s: float) -> list[dict[str, Any]]:
    """One row per batch size for `Soft(1)` and the dense rasterizer by `vmap`, timed in turn."""
    triangles, size = KINDS[kind]
    target = target_of(size)
    coverage = COVERAGES["Soft(1)"]
    plan = sr.plan_for(triangles=triangles, height=size, width=size, coverage=coverage)
    draws = {"Soft(1)": partial(draw_with, plan), "dense": dense_draw(size)}
    calls = {
        f"{name}|{count}": call_of(
            gradient_of(draw, target, by_vmap), *batch_of(count, triangles, size)
        )
        for name, draw in draws.items()
        for count in BATCHES
    }
    times = interleave(calls, budget_s=budget_s)
    return [
        {
            "scene": kind,
            "batch": count,
            "coverage": name,
            "ms": times[f"{name}|{count}"].median,
            "least_ms": times[f"{name}|{count}"].least,
        }
        for name in draws
        for count in BATCHES
    ]
