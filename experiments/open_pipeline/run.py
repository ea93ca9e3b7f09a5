"""Measure gradient and memory of images whose colours the caller computes; see the README.

python -m experiments.open_pipeline.run
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softras2d as sr
from tests.cases.resolving import image_and_gradient, random_weight, resolve_scene
from tests.oracles import edges, texture

from ..common import machine, progress, report
from . import memory

HERE = Path(__file__).parent
SIZE_PX, TRIANGLES, SEED = 24, 8, 0
SAMPLES = (16, 256)
PACKAGES = ("softras2d", "jax", "jaxlib", "equinox", "numpy")
FILTER = sr.Filter(pixel="bilinear", level="zero")
SCENES = {
    "flat": {},
    "interpolated": {"corners": 3},
    "textured": {"corners": 3, "texture": True},
    "interpolated, depth": {"corners": 3, "depth": True},
    "textured, depth": {"corners": 3, "texture": True, "depth": True},
    "flat, translucent": {"translucent": True},
    "interpolated, translucent": {"corners": 3, "translucent": True},
    "interpolated, translucent, depth": {"corners": 3, "depth": True, "translucent": True},
}
"""Arguments of `scene_of` for each scene."""


IMAGE = np.random.default_rng(1).random((6, 8, 3)).astype(np.float32)
"""The texture of all triangles."""


def scene_of(
    corners: int = 1, texture: bool = False, depth: bool = False, translucent: bool = False
) -> sr.Scene:
    """Random triangles with sides of 9 to 19 pixels, which overlap and cross the border.

    With depth, each triangle has one depth; their order is not the draw order.
    """
    rng = np.random.default_rng(SEED)
    centers = rng.random((TRIANGLES, 1, 2)) * SIZE_PX
    angles = rng.uniform(0, 2 * np.pi, (TRIANGLES, 1)) + 2 * np.pi / 3 * np.arange(3)
    radii = rng.uniform(5, 11, (TRIANGLES, 3, 1))
    points = centers + radii * np.stack([np.cos(angles), np.sin(angles)], -1)
    optional: dict[str, Any] = {}
    colors = rng.random((TRIANGLES, corners, 3))
    if translucent:
        alpha = np.random.default_rng(2).uniform(0.2, 0.9, (TRIANGLES, corners, 1))
        colors = np.concatenate([colors, alpha], -1)
    if texture:
        optional["textures"] = sr.TexturePyramid.build([IMAGE])
        optional["texture_index"] = np.zeros(TRIANGLES, np.int32)
        optional["uv"] = rng.random((TRIANGLES, 3, 2)).astype(np.float32)
    if depth:
        order = np.random.default_rng(3).permutation(TRIANGLES)
        optional["depth"] = np.repeat(order[:, None], 3, 1).astype(np.float32)
    return sr.Scene.from_soup(points.astype(np.float32), colors.astype(np.float32), **optional)


def exact_gradient(scene: sr.Scene, weight: Array) -> Float[np.ndarray, "vertices 2"]:
    """Gradient with respect to positions, by quadrature along edges and over the area.

    The quadrature uses no code of the package. `weight` is the weight of each pixel and channel in
    the loss.
    """
    if scene.colors.shape[2] == 4:
        return edges.position_gradient(scene, np.asarray(weight))
    colors = np.broadcast_to(np.asarray(scene.colors, np.float64), (TRIANGLES, 3, 3))
    levels = texture.chain(IMAGE)

    def shade(index: int, weights: np.ndarray) -> np.ndarray:
        values = weights @ colors[index]
        if scene.uv is None:
            return values
        uv = weights @ np.asarray(scene.uv[index], np.float64)
        sampler = texture.Sampler(FILTER.pixel, FILTER.level)
        no_footprint = np.zeros((len(uv), 2, 2))
        return values * texture.sample(levels, uv, no_footprint, sampler)[0][:, :3]

    return edges.position_gradient(
        scene, np.asarray(weight), shade=shade, background=np.asarray(scene.background)
    )


def draw_with_given_colors(scene: sr.Scene, plan: sr.Plan) -> Float[Array, "height width 3"]:
    """Draw an opaque scene by `rasterize` and `resolve`, a translucent one by `composite`."""
    if scene.colors.shape[2] == 3:
        return resolve_scene(scene, plan)
    colors = jnp.broadcast_to(scene.colors, (TRIANGLES, 3, 4))

    def shade(triangle: Any, weights: Any) -> Any:
        return jnp.einsum("nk,nkc->nc", weights, colors[triangle])

    return sr.composite(sr.rasterize(scene, plan, layers=TRIANGLES), shade)


def rows_of(name: str) -> Iterator[dict[str, Any]]:
    """Compare the gradients of a scene with the exact one; one row for each number of samples."""
    scene = scene_of(**SCENES[name])
    exact = None
    for samples in SAMPLES:
        plan = sr.plan(
            scene, height=SIZE_PX, width=SIZE_PX, coverage=sr.Hard(samples), filter=FILTER
        )
        weight = random_weight(plan)
        exact = exact_gradient(scene, weight).ravel() if exact is None else exact
        by_render, by_caller = (
            np.asarray(image_and_gradient(draw, scene, plan, weight)[1].positions, float).ravel()
            for draw in (sr.render, draw_with_given_colors)
        )
        yield {
            "scene": name,
            "samples": samples,
            **compare_with_exact("render", by_render, exact),
            **compare_with_exact("caller", by_caller, exact),
            "difference": float(np.abs(by_caller - by_render).max() / np.abs(by_render).max()),
        }


def compare_with_exact(name: str, gradient: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Cosine between a gradient and the exact gradient, and the ratio of their lengths."""
    length, exact_length = np.linalg.norm(gradient), np.linalg.norm(exact)
    return {
        f"{name}_cosine": float(gradient @ exact / (length * exact_length)),
        f"{name}_scale": float(length / exact_length),
    }


def gradient_table(rows: list[dict[str, Any]]) -> str:
    """The README's table of gradients."""
    header = [
        "scene", "samples", "`render`: cosine", "`render`: scale", "caller's colours: cosine",
        "caller's colours: scale", "largest difference / largest entry",
    ]  # fmt: skip
    names = ("render_cosine", "render_scale", "caller_cosine", "caller_scale")
    body = [
        [
            row["scene"],
            str(row["samples"]),
            *(f"{row[key]:.5f}" for key in names),
            f"{row['difference']:.0e}",
        ]
        for row in rows
    ]
    return report.table(header, body)


def memory_table(row: dict[str, Any]) -> str:
    """The README's table of memory, from what `memory.measure` returns."""
    header = ["512 x 512 px, 256 samples", "GiB"]
    labels = {
        "program_mib": "arguments, results and temporaries, by the compiler",
        "grown_mib": "growth of the process during the call",
        "process_mib": "peak of the process, with imports and compilation",
    }
    return report.table(header, [[labels[key], f"{row[key] / 1024:.2f}"] for key in labels])


def main() -> None:
    rows = [row for name in progress.steps(SCENES, "scenes") for row in rows_of(name)]
    report.write_csv(HERE / "results" / "gradients.csv", rows)
    run = {
        "machine": machine.record(PACKAGES),
        "seed": SEED,
        "precision": "float32",
        "memory": memory.measure(),
    }
    report.write_json(HERE / "results" / "run.json", run)
    report.fill_or_print(
        HERE / "README.md",
        {
            "gradients": gradient_table(rows),
            "memory": memory_table(run["memory"]),
            "machine": machine.describe(run, seed=f"seed {SEED}") + ".",
        },
    )


if __name__ == "__main__":
    main()
