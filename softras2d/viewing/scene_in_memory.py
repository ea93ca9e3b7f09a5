"""Defines the subject that is a scene in memory, such as the scene of a fit.

A subject is a drawing or an image that the viewer shows (`subject.py`).
"""

import math

import equinox as eqx
import numpy as np

from ..numerics.device import to_device
from ..scene import Scene
from .settings import Settings
from .subject import FitState, SceneCache, Subject
from .view import View, enlarged_size

_MAX_DEFAULT_SIDE = 4096
"""Longest side, in pixels, of the canvas that `default_size` chooses."""


class SceneInMemory(Subject):
    """A subject that is a scene in memory, whose positions are in pixels at zoom 1.

    - `height`, `width`: size of the canvas at zoom 1, in pixels.
    - `fit`: progress of the fit that made the scene; None if no fit did.
    - `source`: lines of Python that define the variable `scene`, each with its line break, for
      `command`; empty if there are none. They may use `sr`, which is `softras2d`.
    """

    def __init__(
        self,
        name: str,
        scene: Scene,
        height: int,
        width: int,
        fit: FitState | None = None,
        source: str = "",
    ):
        super().__init__(name)
        self._scene = scene
        self._height, self._width = height, width
        self._fit = fit
        self._source = source
        self._version = 1
        self._scenes = SceneCache()

    @property
    def version(self) -> int:
        """Number of scenes that were shown so far, including the present one."""
        return self._version

    def size(self) -> tuple[int, int]:
        """Height and width of the canvas at zoom 1, in pixels."""
        return self._height, self._width

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene, enlarged by about `zoom`: to the whole pixels of `view.enlarged_size`.

        Raises `ValueError` if the enlarged drawing has too many pixels a side.
        """
        return self._scenes.get(self, zoom, self._enlarge)

    def fit_state(self) -> FitState | None:
        """Progress of the fit that made this scene; None if no fit did."""
        return self._fit

    def replace(self, scene: Scene, fit: FitState | None) -> None:
        """Show another scene of the same size from now on, with the progress of its fit."""
        self._scene, self._fit = scene, fit
        self._version += 1

    def command(self, view: View, settings: Settings) -> str:
        """Python code that draws the same picture, from a variable `scene`."""
        return python_code(view, settings, (self._height, self._width), self._source)

    def _enlarge(self, height: int, width: int) -> Scene:
        """The scene, enlarged from the canvas at zoom 1 to `height` x `width` pixels."""
        return enlarge(self._scene, width / self._width, height / self._height)


def enlarge(scene: Scene, x_scale: int | float, y_scale: int | float) -> Scene:
    """Return a scene whose x are multiplied by `x_scale`, and whose y by `y_scale`.

    The products are computed on the host, where nothing is compiled.
    """
    positions = np.asarray(scene.positions)
    # In float64, so that each coordinate is rounded once.
    moved = positions.astype(np.float64) * np.array([x_scale, y_scale])
    # `dataclasses.replace` would check the scene again.
    return eqx.tree_at(lambda scene: scene.positions, scene, to_device(moved, positions.dtype))


def default_size(scene: Scene) -> tuple[int, int]:
    """Height and width of the smallest canvas from (0, 0) that contains all triangles of a scene.

    A side is from 1 to 4096 pixels, even if the scene reaches further. Vertices that are not finite
    are ignored.
    """
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles).reshape(-1)]
    corners = corners[np.isfinite(corners).all(axis=1)]
    right, bottom = corners.max(axis=0).tolist() if len(corners) else (1.0, 1.0)
    height, width = (
        max(1, math.ceil(min(side, float(_MAX_DEFAULT_SIDE)))) for side in (bottom, right)
    )
    return height, width


def python_code(view: View, settings: Settings, size: tuple[int, int], source: str) -> str:
    """Write Python code that draws a view of a scene.

    - `size`: height and width of the canvas at zoom 1, in pixels.
    - `source`: lines of code that define the variable `scene`, each with its line break; or an
      empty string, if whoever runs the code has such a variable.
    """
    height, width = enlarged_size(*size, view.zoom)
    x_scale, y_scale = width / size[1], height / size[0]
    coverage = {
        "sampled": f"sr.Hard({settings.samples}, {settings.fill_rule!r}, {settings.shading!r})",
        "soft": f"sr.Soft({settings.soft_width!r})",
        "area": "sr.Area()",
    }[settings.coverage]
    filter = (
        f"sr.Filter({settings.pixel_filter!r}, {settings.level_filter!r}, "
        f"{settings.anisotropy}, {settings.lod_bias!r})"
    )
    return (
        "import dataclasses\n\n"
        "import jax.numpy as jnp\nimport numpy as np\nimport softras2d as sr\n\n"
        f"{source}positions = np.asarray(scene.positions, np.float64)\n"
        f"positions = jnp.asarray(positions * [{x_scale!r}, {y_scale!r}], jnp.float32)\n"
        "view = dataclasses.replace(scene, positions=positions)\n"
        f"plan = sr.plan(view, height={view.height}, width={view.width}, "
        f"origin=({view.x}, {view.y}), coverage={coverage}, filter={filter})\n"
        "image = sr.render(view, plan)"
    )
