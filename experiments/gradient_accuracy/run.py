"""Measure the error and the time of the gradient of each coverage mode.

python -m experiments.gradient_accuracy.run [--counts 100,1000,10000] [--photograph FILE]
"""

import argparse
import importlib.util
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..common import machine, progress, report
from ..common.scenes import Soup, random_soup
from ..common.timing import interleave
from . import exact, figure

HERE = Path(__file__).parent
SIZE, SEED = 512, 1
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy", "numba", "deodr")
MODES: dict[str, sr.Hard | sr.Soft | sr.Area] = {
    **{f"hard, {samples}": sr.Hard(samples) for samples in (1, 4, 16, 64)},
    **{f"soft, {width} px": sr.Soft(width) for width in (0.5, 0.8, 1.0, 1.2, 2.0)},
    "soft, window, 1.0 px": sr.Soft(1.0, "window"),
    "area": sr.Area(),
}


FEW = ("hard, 4", "hard, 16", "soft, 0.8 px", "area")
"""Modes that are measured on scenes with translucent triangles or corner colours."""


class Programs:
    """The compiled loss, gradient and tangent of one mode on one scene."""

    def __init__(self, soup: Soup, coverage: Any):
        scene = scene_of(soup)
        plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
        self.arguments = scene.positions, scene.colors

        def loss(positions, colors, target):
            drawn = replace(scene, positions=positions, colors=colors)
            return jnp.mean((sr.render_checked(drawn, plan)[0] - target) ** 2)

        rng = np.random.default_rng(0)
        direction = jnp.asarray(rng.normal(size=scene.positions.shape), jnp.float32)
        self.forward = jax.jit(loss)
        self.gradient = jax.jit(jax.grad(loss, (0, 1)))
        self.tangent = jax.jit(
            lambda p, c, t: jax.jvp(lambda p: loss(p, c, t), (p,), (direction,))[1]
        )
        began = time.perf_counter()
        blank = np.zeros((SIZE, SIZE, 3), np.float32)
        jax.block_until_ready(self.gradient(*self.arguments, blank))
        self.first_call_s = time.perf_counter() - began

    def call(self, function: Callable[..., Any], target: jax.Array) -> Callable[[], Any]:
        return lambda: jax.block_until_ready(function(*self.arguments, target))


def scene_of(soup: Soup) -> sr.Scene:
    colors = soup.colors[:, : 1 if soup.flat else 3, : 3 if soup.opaque else 4]
    return sr.Scene.from_soup(soup.corners, colors)


def cosine(a: Any, b: Any) -> float:
    a, b = (np.asarray(x, np.float64).ravel() for x in (a, b))
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def error(a: Any, b: Any) -> float:
    a, b = (np.asarray(x, np.float64).ravel() for x in (a, b))
    return float(np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-300))


def rows_of(soup: Soup, targets: dict[str, np.ndarray]) -> Iterator[dict[str, Any]]:
    """A row for each target, mode and peer on one scene. All of one target are timed in turn."""
    # The gradient of translucent corner colours at 256 samples per pixel would take 30 GB.
    fine = Programs(soup, sr.Hard(256, edge_gradients=False)) if soup.opaque else None
    scene = scene_of(soup)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(256))
    image = np.asarray(sr.render(scene, plan), np.float64)
    modes = MODES if soup.flat and soup.opaque else {mode: MODES[mode] for mode in FEW}
    programs = {mode: Programs(soup, coverage) for mode, coverage in modes.items()}
    for name, target in targets.items():
        yield from _rows_of(soup, name, target, image, fine, programs)


def _rows_of(
    soup: Soup,
    name: str,
    target: np.ndarray,
    image: np.ndarray,
    fine: Programs | None,
    programs: dict[str, Programs],
) -> Iterator[dict[str, Any]]:
    truth = exact.position_gradient(soup, 2 * (image - target) / image.size)
    target_array = jnp.asarray(target)
    by_color = fine.gradient(*fine.arguments, target_array)[1] if fine else None
    calls: dict[str, Callable[[], Any]] = {}
    gradients: dict[str, tuple[Any, Any]] = {}
    for mode, one in programs.items():
        calls[f"{mode}/forward"] = one.call(one.forward, target_array)
        calls[f"{mode}/gradient"] = one.call(one.gradient, target_array)
        calls[f"{mode}/tangent"] = one.call(one.tangent, target_array)
        gradients[mode] = one.gradient(*one.arguments, target_array)
    if soup.opaque and soup.flat and importlib.util.find_spec("deodr"):
        from .with_deodr import Deodr

        for rate in (1, 4) if soup.count <= 1000 else (1,):
            peer = Deodr(soup, rate)
            gradients[f"DEODR, {rate} x {rate}"] = peer.loss(target)[1:]
            calls[f"DEODR, {rate} x {rate}/gradient"] = lambda peer=peer: peer.loss(target)
    times = interleave(calls, rounds=9, budget_s=30)
    yardstick = times.get("DEODR, 1 x 1/gradient")
    for mode, (by_position, by_colors) in gradients.items():
        by_kind = {kind: times.get(f"{mode}/{kind}") for kind in ("forward", "gradient", "tangent")}
        gradient = by_kind["gradient"]
        yield {
            "scene": soup.kind,
            "triangles": soup.count,
            "target": name,
            "mode": mode,
            "cosine": f"{cosine(by_position, truth):.5f}",
            "relative_error": error(by_position, truth),
            "color_cosine": "" if by_color is None else f"{cosine(by_colors, by_color):.6f}",
            **{f"{kind}_ms": one.median if one else "" for kind, one in by_kind.items()},
            "least_gradient_ms": gradient.least if gradient else "",
            "over_deodr": gradient.median / yardstick.median if gradient and yardstick else "",
            "first_call_s": programs[mode].first_call_s if mode in programs else "",
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", default="100,1000,10000")
    parser.add_argument(
        "--kinds",
        default="flat,flat_a50,gouraud,gouraud_a50",
        help="Scenes to measure; results of other scenes are kept.",
    )
    parser.add_argument("--photograph", type=Path, help="A second target, besides white noise.")
    options = parser.parse_args()
    rng = np.random.default_rng(SEED)
    targets = {"white noise": rng.random((SIZE, SIZE, 3), dtype=np.float32)}
    if options.photograph:
        picture = np.asarray(sr.read_image(options.photograph))[..., :3]
        side = min(picture.shape[:2]) // SIZE * SIZE
        cut = picture[:side, :side].reshape(SIZE, side // SIZE, SIZE, side // SIZE, 3)
        targets["photograph"] = cut.mean((1, 3)).astype(np.float32)
    results = HERE / "results" / "gradients.csv"
    kinds = options.kinds.split(",")
    stored = report.read_csv(results) if results.exists() else []
    rows = [row for row in stored if row["scene"] not in kinds]
    cells = [
        (kind, int(count))
        for kind in kinds
        for count in options.counts.split(",")
        if kind == "flat" or int(count) == 1000
    ]
    for kind, count in progress.steps(cells, "scenes"):
        rows += rows_of(random_soup(count, SIZE, kind), targets)
        report.write_csv(results, rows)
        about = machine.record(PACKAGES)
        run = {"machine": about, "seed": SEED, "precision": "float32"}
        report.write_json(HERE / "results" / "run.json", run)
    figure.publish(HERE / "results", HERE / "README.md")


if __name__ == "__main__":
    main()
