"""Compare anisotropic filters at one sample per pixel: the package's probes and EWA."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

import softras2d as sr

from .ewa import Ewa, filtered
from .footprints import Footprints, footprints
from .measures import rmse
from .methods import ANISOTROPY, Method
from .programs import Program

SCENES = ("ground", "stretched")
CHOICES = (
    *(Ewa(radius, 2.0) for radius in (1.0, 0.85, 0.7, 0.6)),
    *(Ewa(0.7, least) for least in (1.5, 4.0)),
)
BIASES = (0.0, -0.5)


def compare(
    scene: sr.Scene, name: str, reference: np.ndarray, programs: dict[Method, Program]
) -> list[dict[str, Any]]:
    """A row for each filter, over pixels that no edge of a surface crosses."""
    at = footprints(scene, plane=name == "ground")
    wanted = [Method("bilinear", "linear", probes, 1) for probes in (1, *ANISOTROPY)]
    rows = []
    for bias in BIASES:
        for method in wanted:
            if method in programs:
                rows.append(_probes_row(scene, at, reference, programs[method], method, bias))
    for choice in CHOICES:
        colors, reads, tests = filtered(scene, at, choice)
        error = rmse(colors, reference[at.interior])
        rows.append(_row(choice.name, error, reads, int(reads.max()), int(tests.max())))
    return [{"scene": name, "pixels": int(at.interior.sum())} | row for row in rows]


def _probes_row(
    scene: sr.Scene,
    at: Footprints,
    reference: np.ndarray,
    program: Program,
    method: Method,
    bias: float,
) -> dict[str, Any]:
    biased = replace(program.plan.filter, lod_bias=jnp.asarray(bias, jnp.float32))
    image = program.draw(scene, replace(program.plan, filter=biased))
    longer, shorter = at.axes()
    probes = np.clip(np.ceil(longer / np.maximum(shorter, 1e-9)), 1, method.anisotropy)
    name = "trilinear" if method.anisotropy == 1 else f"up to {method.anisotropy} probes"
    name += f", bias {bias:g}" if bias else ""
    most = method.texels
    return _row(name, rmse(image, reference, at.interior), 8 * probes, most, most)


def _row(name: str, error: float, reads: np.ndarray, most: int, steps: int) -> dict[str, Any]:
    """A row: `reads` has the texels read by each pixel, and `most` those of the costliest pixel.

    `steps` is the number of texels per pixel in a program in which all pixels take the same steps.
    """
    mean = float(reads.mean())
    return {"filter": name, "rmse": error, "mean_texels": mean, "most_texels": most, "steps": steps}
