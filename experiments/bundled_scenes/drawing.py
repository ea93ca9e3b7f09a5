"""Helpers of the scripts that draw bundled scenes: SVG files, elements and colour codes."""

from collections.abc import Iterable

import numpy as np

from softras2d.scenes import SIZE


def document(purpose: str, lines: Iterable[str]) -> str:
    """Text of an SVG file: a comment with the purpose of the scene, then the elements."""
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE}" height="{SIZE}" '
            f'viewBox="0 0 {SIZE} {SIZE}">',
            f"<!-- {purpose} -->",
            "<!-- Written by experiments/bundled_scenes/make.py. -->",
            *lines,
            "</svg>\n",
        ]
    )


def page(color: str) -> str:
    """A rect that covers the picture, as its background."""
    return f'<rect x="0" y="0" width="{SIZE}" height="{SIZE}" fill="{color}"/>'


def polygon(points: np.ndarray, attributes: str, digits: int = 2) -> str:
    """A polygon through `points` `[n, 2]`, rounded to `digits` decimals."""
    pairs = " ".join(f"{number(x, digits)},{number(y, digits)}" for x, y in points.tolist())
    return f'<polygon points="{pairs}" {attributes}/>'


def polar(radius: float | np.ndarray, degrees: float | np.ndarray) -> np.ndarray:
    """Points around the middle of the picture; 0 degrees is up, and angles turn clockwise."""
    angle = np.radians(degrees)
    return SIZE / 2 + np.stack([radius * np.sin(angle), -radius * np.cos(angle)], axis=-1)


def code(rgb: np.ndarray) -> str:
    """`#rrggbb` of RGB in 0..255."""
    return "#" + "".join(f"{round(float(channel)):02x}" for channel in np.clip(rgb, 0, 255))


def number(value: float, digits: int) -> str:
    """The shortest text of `value`, rounded to `digits` decimals."""
    # Adding zero turns a negative zero into zero.
    return f"{round(value, digits) + 0.0:.8g}"
