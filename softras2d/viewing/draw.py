"""Draws views with `render`, as pictures of bytes.

A view is the part of an enlarged drawing that a canvas shows (`view.py`). A plan is the options and
the array sizes of the compiled program that draws it; `plans.py` explains tight plans and headroom.
A scene outgrows a plan if it needs larger arrays.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8, UInt32

from ..numerics.compiled_programs import drop_programs
from ..planning.plan import Plan
from ..rendering.render import render_checked
from ..scene import Scene
from .background import PlanCompiler
from .plans import TIGHT_PLAN_PIXELS, ViewPlans, kind_of
from .settings import Settings
from .view import View

T = TypeVar("T")

_COMPILE_EVENT = "/jax/core/compile/backend_compile_duration"
"""Event by which JAX reports the duration of each compilation."""


class Picture(NamedTuple):
    """The picture of a view.

    - `rgba`: straight RGBA in sRGB; alpha is 255 everywhere if the background is opaque.
    - `plan`: the plan with which the picture was drawn.
    - `seconds`: time to draw the picture, including `compile_seconds`, the time spent compiling.
    """

    rgba: UInt8[np.ndarray, "height width 4"]
    plan: Plan
    seconds: float
    compile_seconds: float


class Artist:
    """Draws views, and stores their plans for later views. Only one thread may use it at a time."""

    def __init__(self):
        self._plans = ViewPlans()
        self._compiler = PlanCompiler()

    def draw(self, scene: Scene, view: View, settings: Settings) -> Picture:
        """Draw a view of a scene; the scene has already been enlarged by the zoom of the view.

        Raises `ValueError` for an invalid scene, and for a view that takes too much memory.
        """
        began = time.perf_counter()
        with compile_times() as compile_seconds:
            image, plan = self.render(scene, view, settings)
            rgba = to_rgba(image)
        if compile_seconds and not self._compiler.is_busy():
            drop_programs()
        return Picture(rgba, plan, time.perf_counter() - began, sum(compile_seconds))

    def prepare_zoom(self, scene: Scene, view: View, settings: Settings) -> None:
        """Compile a plan with headroom in another thread, if the canvas is large.

        A plan with headroom is also large enough for this view at twice the zoom. A canvas is large
        from `TIGHT_PLAN_PIXELS` on. Its first plan is tight, that is, just large enough for the
        view that it was made for, so that a view at a higher zoom soon needs the plan with
        headroom. The call does not wait for the compilation.
        """
        if view.height * view.width >= TIGHT_PLAN_PIXELS:
            self._compiler.start(kind_of(scene, view, settings), scene, view, settings)

    def render(
        self, scene: Scene, view: View, settings: Settings, grid_bits: int | None = None
    ) -> tuple[Float[Array, "height width channels"], Plan]:
        """Draw the image of a view; returns the image, and the plan that was used.

        `grid_bits` is as in `softras2d.plan`. The image has floats, `[height, width, 3 or 4]`, with
        straight alpha. Errors are those of `draw`.
        """
        return self.with_plan(render_checked, scene, view, settings, grid_bits)

    def with_plan(
        self,
        compute: Callable[[Scene, Plan], tuple[T, Any]],
        scene: Scene,
        view: View,
        settings: Settings,
        grid_bits: int | None = None,
    ) -> tuple[T, Plan]:
        """Call `compute(scene, plan)` with a plan that is large enough.

        `compute` gets the argument `scene` itself, which is not padded to the size class of the
        plan. It returns a value, and whether the scene outgrew the plan, that is, needed larger
        arrays. If it did, `compute` is called again with a larger plan, at most twice. The first
        larger plan is the one that `prepare_zoom` requested for this kind of views. It is skipped
        if there is none, or if `grid_bits` is given. The second larger plan is made for this view,
        so it must be large enough. Returns the value of the last call, and the plan of that call.
        `grid_bits` is as in `softras2d.plan`.
        """
        plan = self._plans.choose(scene, view, settings, grid_bits)
        value, overflow = compute(scene, plan)
        compiled_plan = None
        if bool(overflow) and grid_bits is None:
            compiled_plan = self._compiler.take(kind_of(scene, view, settings))
        if compiled_plan is not None:
            plan = self._plans.adopt(scene, view, settings, compiled_plan)
            value, overflow = compute(scene, plan)
        if bool(overflow):
            plan = self._plans.enlarge(scene, view, settings, grid_bits)
            value, overflow = compute(scene, plan)
            assert not bool(overflow), "a plan must hold the scene that it was made for"
        return value, plan

    def is_compiling(self) -> bool:
        """Whether a plan for later views is being compiled in the thread of the compiler."""
        return self._compiler.is_busy()

    def close(self) -> None:
        """Wait until the compiler's thread has finished the present program, and stop the thread.

        Plans that are still waiting for the thread are dropped.
        """
        self._compiler.close()


@contextmanager
def compile_times() -> Iterator[list[float]]:
    """Collect the times, in seconds, of the compilations in this thread, as a context manager.

    Yields a list, to which each compilation within the body adds its time.
    """
    seconds: list[float] = []
    thread = threading.get_ident()

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == _COMPILE_EVENT and threading.get_ident() == thread:
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seconds
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def to_rgba(image: Float[Array, "height width channels"]) -> UInt8[np.ndarray, "height width 4"]:
    """Convert an image of floats, RGB or straight RGBA, to bytes of RGBA; RGB gets an alpha of 255.

    Values are clipped to 0..1 and rounded to k/255 as by `io.pixel_values.to_bytes`, bit for bit.
    """
    # On a big-endian machine the bytes of a word would be in the opposite order.
    words = np.asarray(_to_words(image)).astype("<u4", copy=False)
    return words.view(np.uint8).reshape(*words.shape, 4)


@jax.jit
def _to_words(image: Float[Array, "height width channels"]) -> UInt32[Array, "height width"]:
    """Convert each pixel to a word of four bytes: from the lowest, red, green, blue and alpha.

    Alpha is 255 for an image of three channels. The compiler vectorises operations on words, but
    not the interleaving of bytes.
    """
    levels = [_to_level(image[..., channel]) for channel in range(image.shape[-1])]
    if len(levels) == 3:
        levels.append(jnp.full(image.shape[:2], 255, jnp.uint32))
    red, green, blue, alpha = levels
    return red | (green << 8) | (blue << 16) | (alpha << 24)


def _to_level(channel: Float[Array, "height width"]) -> UInt32[Array, "height width"]:
    """Clip the values of a channel to 0..1, and round 255 times the value to an integer.

    The compiler may round the product and the sum together, once instead of twice. That gives the
    same integer for every float32 in 0..1.
    """
    return jnp.floor(jnp.clip(channel, 0.0, 1.0) * 255.0 + 0.5).astype(jnp.uint32)
