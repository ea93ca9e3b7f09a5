"""Position labels beside points so that none covers another label or a point, or leaves the axes.

The method is greedy. Points with many close neighbours come first. Each label takes the cheapest of
several positions around its point, and a label that is further away gets a line to the point.
"""

# pyright: reportMissingImports=false

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

RADII_PX = (9, 14, 20, 28, 38, 50, 65, 82, 102, 125, 150)
ANGLES = 24
MARKER_PX = 7
"""Half the side, in pixels, of the square around a point that labels must not cover."""
LEADER_FROM_PX = 16
"""Length, in pixels, above which the line from a label to its point is drawn."""


@dataclass(frozen=True)
class Label:
    """Text beside a point of the axes, which is in data coordinates."""

    x: float
    y: float
    text: str
    color: str


def place(
    axes: Any,
    labels: list[Label],
    fontsize: float,
    paths: Sequence[list[tuple[float, float]]] = (),
) -> int:
    """Draw the labels; the axes must have their final position and limits.

    `paths` are lines on the axes, as points in data coordinates, which labels avoid if they can.
    Returns how many labels still overlap another label or a point.
    """
    renderer = axes.figure.canvas.get_renderer()
    frame = axes.get_window_extent(renderer)
    limits = np.array([frame.x0, frame.y0, frame.x1, frame.y1])
    points = axes.transData.transform([(label.x, label.y) for label in labels])
    markers = np.concatenate([points - MARKER_PX, points + MARKER_PX], 1)
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
    taken = np.zeros((0, 4))
    lines = np.concatenate([np.zeros((0, 2)), *(_sampled(axes, path) for path in paths)])
    clashes = 0
    for number in np.argsort(-(gaps < 60).sum(1), kind="stable"):
        label, point = labels[number], points[number]
        size = _size(axes, label.text, fontsize, renderer)
        others = np.delete(markers, number, 0)
        options = [
            _option(point, size, angle, radius)
            for radius in RADII_PX
            for angle in np.arange(ANGLES) * (2 * np.pi / ANGLES)
        ]
        costs = [_cost(*option, limits, taken, others, lines, points) for option in options]
        best = int(np.argmin(costs))
        box, leader = options[best]
        clashes += int(_hits(box, taken).any() or _hits(box, others).any())
        taken = np.vstack([taken, box])
        _write(axes, label, point, box, leader, fontsize)
        if _length(leader) > LEADER_FROM_PX:
            lines = np.vstack([lines, leader])
    return clashes


def _sampled(axes: Any, path: list[tuple[float, float]]) -> NDArray[np.float64]:
    """Points along a polyline, in display pixels, about four pixels apart."""
    ends = axes.transData.transform(path)
    pieces = [
        a + np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / 4))[:, None] * (b - a)
        for a, b in pairwise(ends)
    ]
    return np.concatenate([np.zeros((0, 2)), *pieces])


def _size(axes: Any, text: str, fontsize: float, renderer: Any) -> NDArray[np.float64]:
    """Width and height of a label in display pixels, with a margin."""
    drawn = axes.text(0.5, 0.5, text, fontsize=fontsize, transform=axes.transAxes)
    extent = drawn.get_window_extent(renderer)
    drawn.remove()
    return np.array([extent.width + 3.0, extent.height + 2.0])


def _option(
    point: NDArray[np.float64], size: NDArray[np.float64], angle: float, radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box `x0, y0, x1, y1` of a label in one position, and its sampled line to the point."""
    direction = np.array([np.cos(angle), np.sin(angle)])
    # The distance from the box's middle to its side in this direction, plus `radius`.
    reach = np.min(size / 2 / np.maximum(np.abs(direction), 1e-9))
    middle = point + direction * (radius + reach)
    near = point + direction * radius
    leader = point + np.linspace(0, 1, 16)[:, None] * (near - point)
    return np.concatenate([middle - size / 2, middle + size / 2]), leader


def _cost(
    box: NDArray[np.float64],
    leader: NDArray[np.float64],
    limits: NDArray[np.float64],
    taken: NDArray[np.float64],
    others: NDArray[np.float64],
    lines: NDArray[np.float64],
    points: NDArray[np.float64],
) -> float:
    """Cost of a position: first by what it covers, then by the distance from label to point."""
    outside = np.any(box[:2] < limits[:2] + 2) or np.any(box[2:] > limits[2:] - 2)
    cost = 1e6 * outside + 1e4 * _hits(box, taken).sum() + 3e3 * _hits(box, others).sum()
    cost += 30.0 * _inside(lines, box[None]).any()
    if taken.size:
        cost += 1e3 * _inside(leader, taken).any(0).sum()
    far = leader[6:]
    if len(lines) and _length(leader) > LEADER_FROM_PX:
        cost += 100.0 * (np.linalg.norm(lines[:, None] - far[None], axis=2) < 3).any()
    cost += 150.0 * (_inside(far, others).any(0).sum() if len(points) > 1 else 0)
    return float(cost + _length(leader))


def _length(leader: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(leader[-1] - leader[0]))


def _hits(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each of `boxes` overlaps `box`."""
    return np.all((boxes[:, :2] < box[2:]) & (boxes[:, 2:] > box[:2]), axis=1)


def _inside(points: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each point is inside each box, `[points, boxes]`."""
    low = points[:, None] > boxes[None, :, :2]
    return np.all(low & (points[:, None] < boxes[None, :, 2:]), axis=2)


def _write(
    axes: Any,
    label: Label,
    point: NDArray[np.float64],
    box: NDArray[np.float64],
    leader: NDArray[np.float64],
    fontsize: float,
) -> None:
    x, y = axes.transAxes.inverted().transform((box[:2] + box[2:]) / 2)
    axes.text(
        x, y, label.text, fontsize=fontsize, color=label.color, transform=axes.transAxes,
        ha="center", va="center", zorder=5,
    )  # fmt: skip
    if _length(leader) > LEADER_FROM_PX:
        ends = axes.transAxes.inverted().transform(leader[[5, -1]])
        axes.plot(*ends.T, color=label.color, linewidth=0.5, transform=axes.transAxes, zorder=1)
