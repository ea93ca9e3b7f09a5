"""Measure the PSNR of fits, for several numbers of parameters and time limits.

python -m experiments.fit_kodak.run [FOLDER] [--astronaut] [--mesh 12300,24600] [--linear 98000]
    [--layers 200:30,1000:60] [--seconds 240] [--into results/NAME] [--statics]
"""

import argparse
import importlib.util
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d import pictures
from softras2d.fitting.mesh.colors import ColorModel, solve_colors, to_corner_colors
from softras2d.fitting.mesh.edge_flips import flip_to_delaunay
from softras2d.fitting.mesh.insertion import insert
from softras2d.fitting.mesh.start import COARSE, GROWTH, error_start, uniform_start
from softras2d.fitting.mesh.triangulation import Mesh
from softras2d.fitting.score import Scorer
from softras2d.fitting.target import Target

from ..common import machine, progress, report
from . import figure

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optimistix", "numpy", "scipy", "scikit-image", "deodr")

SEED = 0


class Case(NamedTuple):
    """One fit of one picture.

    Parameters: 5 for each vertex that triangles share, 10 for each triangle with separate corner
    colours, 9 for each flat layer.
    """

    family: str
    shading: str
    parameters: int
    seconds: float

    @property
    def vertices(self) -> int:
        """Number of vertices of a mesh that has this many parameters."""
        return self.parameters // 5 if self.shading == "gouraud" else self.parameters // 20

    @property
    def triangles(self) -> int:
        return self.parameters // 9 if self.family == "layers" else 2 * self.vertices - 6


def fit_row(name: str, target: np.ndarray, case: Case) -> dict[str, Any]:
    """Fit one picture; return the row of the fit, and of static meshes with as many vertices."""
    began = time.perf_counter()
    result = sr.fit(
        target,
        triangles=case.triangles,
        family=case.family,
        shading=case.shading,
        seconds=case.seconds,
        seed=SEED,
    )
    seconds = time.perf_counter() - began
    row = {
        "picture": name,
        "family": case.family,
        "shading": case.shading,
        "parameters": case.parameters,
        "triangles": result.scene.triangles.shape[0],
        "psnr": result.psnr,
        "ssim": result.ssim,
        "seconds": seconds,
        "steps": result.history[-1].steps,
        "greedy_psnr": "",
        "static_psnr": "",
        "static_seconds": "",
    }
    return row if case.family == "layers" else row | static_row(target, case)


def deodr_row(name: str, target: np.ndarray, case: Case) -> dict[str, Any]:
    """Fit a square picture with DEODR in the same time; return a row like `fit_row`."""
    from .with_deodr import fit

    began = time.perf_counter()
    scene, steps = fit(target, case.triangles, case.seconds, SEED)
    seconds = time.perf_counter() - began
    score = Scorer(target).score(scene)
    return {
        "picture": name,
        "family": case.family,
        "shading": "flat, by DEODR",
        "parameters": case.parameters,
        "triangles": case.triangles,
        "psnr": score.psnr,
        "ssim": score.ssim,
        "seconds": seconds,
        "steps": steps,
        "greedy_psnr": "",
        "static_psnr": "",
        "static_seconds": "",
    }


def static_row(target: np.ndarray, case: Case) -> dict[str, float]:
    """PSNR, in dB, of two meshes whose vertices do not move, and seconds to make the second.

    Vertices are inserted greedily, and colours solve a least-squares problem. The mesh of
    `greedy_psnr` stays Delaunay; in the mesh of `static_psnr`, edges are flipped if that lowers the
    error.
    """
    began = time.perf_counter()
    model = "vertex" if case.shading == "gouraud" else "linear"
    flipped = error_start(Target(target), case.vertices, model=model, seed=SEED, exchanges=0)
    seconds = time.perf_counter() - began
    plain = greedy_mesh(target, case.vertices, model)
    return {
        "greedy_psnr": static_psnr(target, plain, model),
        "static_psnr": static_psnr(target, flipped, model),
        "static_seconds": seconds,
    }


def greedy_mesh(target: np.ndarray, vertices: int, model: ColorModel) -> Mesh:
    """Insert vertices where they lower the error most, in a mesh that stays Delaunay."""
    height, width = target.shape[:2]
    mesh = uniform_start(height, width, min(vertices, COARSE), jitter=0.1, seed=SEED)
    while (have := len(mesh.positions)) < vertices:
        more = min(max(1, int(have * GROWTH)), vertices - have)
        mesh = flip_to_delaunay(insert(mesh, Target(target), more, model=model))
        if len(mesh.positions) == have:
            break
    return mesh


def static_psnr(target: np.ndarray, mesh: Mesh, model: ColorModel) -> float:
    colors = solve_colors(mesh, Target(target), model=model)
    corners = np.clip(to_corner_colors(mesh, colors, model), 0, 1)
    scene = sr.Scene.from_mesh(
        jnp.asarray(mesh.positions, jnp.float32), mesh.triangles, triangle_colors=corners
    )
    return Scorer(target).score(scene).psnr


def renew_statics(path: Path, images: dict[str, np.ndarray]) -> None:
    """Measure the static meshes of all rows of a file again; the fits keep their results."""
    rows = report.read_csv(path)
    missing = {row["picture"] for row in rows} - set(images)
    if missing:
        raise SystemExit(f"{path}: {', '.join(sorted(missing))} is not among the pictures.")
    for number in progress.steps(range(len(rows)), "rows"):
        row = rows[number]
        if row["family"] == "mesh":
            case = Case("mesh", row["shading"], int(row["parameters"]), float(row["seconds"]))
            row |= static_row(images[row["picture"]], case)
    keys = dict.fromkeys(key for row in rows for key in row)
    report.write_csv(path, [{key: row.get(key, "") for key in keys} for row in rows])


def targets(folder: Path | None, astronaut: bool) -> dict[str, np.ndarray]:
    """Pictures by name: those of a folder, or the bundled ones."""
    if astronaut:
        from skimage import data  # pyright: ignore[reportMissingImports]

        return {"astronaut": data.astronaut().astype(np.float32) / 255}
    if folder is None:
        return {name: sr.read_image(pictures.path(name)) for name in pictures.names()}
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".png", ".jpg", ".jpeg"))
    if not files:
        raise SystemExit(f"{folder}: contains no .png or .jpg file.")
    return {path.stem: sr.read_image(path)[..., :3] for path in files}


def cases(chosen: argparse.Namespace) -> list[Case]:
    listed = [Case("mesh", "gouraud", count, chosen.seconds) for count in chosen.mesh]
    listed += [Case("mesh", "linear", count, chosen.seconds) for count in chosen.linear]
    for entry in chosen.layers:
        count, seconds = entry.split(":")
        listed.append(Case("layers", "flat", 9 * int(count), float(seconds)))
    return listed


def main() -> None:
    numbers = lambda text: [int(part) for part in text.split(",") if part]  # noqa: E731
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--astronaut", action="store_true")
    parser.add_argument("--only", default="", help="Names of pictures, separated by commas.")
    parser.add_argument("--mesh", type=numbers, default=[1500])
    parser.add_argument("--linear", type=numbers, default=[])
    parser.add_argument(
        "--layers", type=lambda t: [p for p in t.split(",") if p], default=["100:20"]
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument(
        "--statics", action="store_true", help="Measure only the static meshes again."
    )
    parser.add_argument("--into", type=Path, default=HERE / "results" / "bundled")
    chosen = parser.parse_args()
    began = time.perf_counter()
    wanted = [name for name in chosen.only.split(",") if name]
    images = targets(chosen.folder, chosen.astronaut)
    if chosen.statics:
        renew_statics(chosen.into / "fits.csv", images)
        figure.publish(HERE / "results", HERE / "README.md")
        return
    if set(wanted) - set(images):
        raise SystemExit(f"--only: no picture {', '.join(sorted(set(wanted) - set(images)))}.")
    work = [
        (name, case) for name in images if not wanted or name in wanted for case in cases(chosen)
    ]
    chosen.into.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, case in progress.steps(work, "fits"):
        rows.append(fit_row(name, images[name], case))
        square = images[name].shape[0] == images[name].shape[1]
        if case.family == "layers" and square and importlib.util.find_spec("deodr"):
            rows.append(deodr_row(name, images[name], case))
        # Write after each picture, so that results remain if the run is interrupted.
        report.write_csv(chosen.into / "fits.csv", rows)
    run = {
        "arguments": {k: str(v) for k, v in vars(chosen).items() if k not in ("folder", "into")},
        "machine": machine.record(PACKAGES),
        "precision": "float32",
        "seconds": time.perf_counter() - began,
    }
    (chosen.into / "run.json").write_text(json.dumps(run, indent=1) + "\n")
    figure.publish(HERE / "results", HERE / "README.md")


if __name__ == "__main__":
    main()
