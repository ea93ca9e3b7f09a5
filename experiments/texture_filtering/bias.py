"""Measure mip levels that are lowered to the spacing of the samples.

python -m experiments.texture_filtering.bias
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from ..common import report
from ..common.references import cache_programs
from . import subjects, tables
from .measures import moire, rmse
from .methods import SAMPLES, Method
from .programs import Program
from .run import CACHE, SEED

HERE = Path(__file__).parent


def measure() -> list[dict[str, Any]]:
    """A row for each scene, number of samples and bias.

    The bias is zero, or goes half or all of the way to the spacing of the samples.
    """
    scenes = subjects.load(SEED)
    rows = []
    for names in (subjects.FLAT, (subjects.GROUND,)):
        for samples in SAMPLES[1:]:
            program = Program(
                [scenes[name] for name in names], Method("bilinear", "linear", 1, samples)
            )
            # The spacing of samples is a pixel divided by the root of their number.
            spacing = 0.5 * math.log2(samples)
            for bias in (0.0, -0.5 * spacing, -spacing):
                value = jnp.asarray(bias, jnp.float32)
                plan = replace(program.plan, filter=replace(program.plan.filter, lod_bias=value))
                for name in names:
                    image = program.draw(scenes[name], plan)
                    truth = subjects.reference(scenes[name], CACHE / "references")
                    row: dict[str, Any] = {"scene": name, "samples": samples, "lod_bias": bias}
                    row["rmse"] = rmse(image, truth)
                    zone = name == "zone_plate"
                    texture = subjects.base(scenes[name], names.index(name)) if zone else truth
                    row["moire"] = moire(image, truth, texture) if zone else ""
                    rows.append(row)
    return rows


if __name__ == "__main__":
    cache_programs(CACHE / "xla")
    report.write_csv(HERE / "results" / "bias.csv", measure())
    tables.publish(HERE / "results", HERE / "README.md")
