"""Compiled renders, one for each filter, number of samples and scene structure."""

import jax
import numpy as np

import softras2d as sr
from softras2d.rendering.render import compile_render

from .methods import Method
from .subjects import SIZE


class Program:
    """A render that several scenes of one structure share."""

    def __init__(self, scenes: list[sr.Scene], method: Method):
        self.plan = sr.plan(
            scenes,
            height=SIZE,
            width=SIZE,
            coverage=sr.Hard(samples=method.samples),
            filter=method.filter(),
        )
        self._compiled = compile_render(scenes[0], self.plan)

    @property
    def traffic(self) -> float:
        """Bytes that kernels read and write, by the compiler's count; loop bodies count once."""
        analysis = self._compiled.compiled.cost_analysis() or {}
        return analysis.get("bytes accessed", float("nan"))

    def run(self, scene: sr.Scene) -> None:
        """Draw once, and wait until the image is ready."""
        jax.block_until_ready(self._compiled(scene, self.plan))

    def draw(self, scene: sr.Scene, plan: sr.Plan | None = None) -> np.ndarray:
        """The image `[height, width, 3]`; another plan may differ in its arrays."""
        return np.asarray(self._compiled(scene, self.plan if plan is None else plan)[0])
