"""Differentiate a scene by its positions in every way, and compute the exact gradient.

The loss is the mean squared difference to an image of white noise, so that every edge counts.
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
from ..hard_speed.own import CORES
from . import tiling_gradient, ways
from .subjects import Subject

TARGET_SEED = 1


@dataclass(frozen=True)
class Slope:
    """One way: `call` draws forwards and backwards, `read` gives `[vertices, 2]` of its result."""

    family: str
    label: str
    threads: int
    call: Callable[[], Any]
    read: Callable[[Any], NDArray[np.float64]]


def target_of(subject: Subject) -> NDArray[np.float32]:
    rng = np.random.default_rng(TARGET_SEED)
    return rng.random((subject.size, subject.size, 3), dtype=np.float32)


def truth(subject: Subject, reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """By quadrature along visible edges, about the reference image; `[vertices, 2]`."""
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


def slopes(subject: Subject, quick: bool) -> list[Slope]:
    target = target_of(subject)
    found = [_own(subject, target, *one) for one in ways.coverages(subject, quick)]
    return found + _deodr(subject, target)


def _own(
    subject: Subject, target: NDArray[np.float32], family: str, label: str, coverage: Any
) -> Slope:
    """Value and gradient by all positions."""
    scene, size = subject.scene, subject.size
    plan = sr.plan(scene, height=size, width=size, coverage=coverage)
    held = jnp.asarray(target)

    def loss(positions: jax.Array) -> jax.Array:
        image, _ = sr.render_checked(replace(scene, positions=positions), plan)
        return jnp.mean((image - held) ** 2)

    both = jax.jit(jax.value_and_grad(loss))
    return Slope(
        family,
        label,
        CORES,
        lambda: jax.block_until_ready(both(scene.positions)),
        lambda got: np.asarray(got[1], np.float64),
    )


def _deodr(subject: Subject, target: NDArray[np.float32]) -> list[Slope]:
    """Per corner; where triangles share vertices, what their corners receive is added."""
    soup = subject.soup
    if soup is None or not soup.opaque or "DEODR" in ways.missing():
        return []
    from ..gradient_accuracy.with_deodr import Deodr

    triangles = np.asarray(subject.scene.triangles)
    vertices = subject.scene.positions.shape[0]

    def read(got: Any) -> NDArray[np.float64]:
        gathered = np.zeros((vertices, 2))
        np.add.at(gathered, triangles, got[1])
        return gathered

    def one(rate: int) -> Slope:
        peer = Deodr(soup, rate)
        return Slope("DEODR", f"{rate}x{rate}", 1, lambda: peer.loss(target), read)

    return [one(1), one(4)]
