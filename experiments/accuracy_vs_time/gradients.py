"""Gradients with respect to positions by every method, and the exact gradient.

The loss is the mean squared difference to an image of white noise, so that every edge contributes.
"""

# pyright: reportMissingImports=false

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import softras2d as sr

from ..gradient_accuracy import exact
from ..hard_speed.ours import CORES
from . import tiling_gradient, ways
from .subjects import Subject

TARGET_SEED = 1


@dataclass(frozen=True)
class GradientMethod:
    """A method that computes the gradient.

    - `call()` draws and differentiates.
    - `read(result)` extracts the gradient `[vertices, 2]` from what `call` returned.
    """

    family: str
    label: str
    threads: int
    call: Callable[[], Any]
    read: Callable[[Any], NDArray[np.float64]]


def target_of(subject: Subject) -> NDArray[np.float32]:
    rng = np.random.default_rng(TARGET_SEED)
    return rng.random((subject.size, subject.size, 3), dtype=np.float32)


def truth(subject: Subject, reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """The exact gradient `[vertices, 2]`, by quadrature along visible edges."""
    soup, scene = subject.soup, subject.scene
    assert soup is not None
    weights = 2 * (reference - target_of(subject)) / reference.size
    if subject.tiling:
        positions = np.asarray(scene.positions, np.float64)
        colors = soup.colors[:, 0, :3].astype(np.float64)
        return tiling_gradient.position_gradient(
            positions, np.asarray(scene.triangles), colors, weights
        )
    return exact.position_gradient(soup, weights).reshape(-1, 2)


def methods_of(subject: Subject, quick: bool) -> list[GradientMethod]:
    target = target_of(subject)
    methods = [_package_method(subject, target, *one) for one in ways.coverages(subject, quick)]
    return methods + _deodr(subject, target)


def _package_method(
    subject: Subject, target: NDArray[np.float32], family: str, label: str, coverage: Any
) -> GradientMethod:
    """Value, and gradient with respect to all positions, by the package in one coverage mode."""
    scene, size = subject.scene, subject.size
    plan = sr.plan(scene, height=size, width=size, coverage=coverage)
    target_array = jnp.asarray(target)

    def loss(positions: jax.Array) -> jax.Array:
        image, _ = sr.render_checked(replace(scene, positions=positions), plan)
        return jnp.mean((image - target_array) ** 2)

    value_and_gradient = jax.jit(jax.value_and_grad(loss))
    return GradientMethod(
        family,
        label,
        CORES,
        lambda: jax.block_until_ready(value_and_gradient(scene.positions)),
        lambda result: np.asarray(result[1], np.float64),
    )


def _deodr(subject: Subject, target: NDArray[np.float32]) -> list[GradientMethod]:
    """DEODR's gradient with respect to corners, summed over the corners of each shared vertex."""
    soup = subject.soup
    if soup is None or not soup.opaque or "DEODR" in ways.missing():
        return []
    from ..gradient_accuracy.with_deodr import Deodr

    triangles = np.asarray(subject.scene.triangles)
    vertices = subject.scene.positions.shape[0]

    def read(result: Any) -> NDArray[np.float64]:
        gradient = np.zeros((vertices, 2))
        np.add.at(gradient, triangles, result[1])
        return gradient

    def one(rate: int) -> GradientMethod:
        peer = Deodr(soup, rate)
        return GradientMethod("DEODR", f"{rate}x{rate}", 1, lambda: peer.loss(target), read)

    return [one(1), one(4)]
