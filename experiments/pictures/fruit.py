"""Fruit on a chequered cloth: shaded balls, highlights, and shadows with soft edges."""

import numpy as np

SIDE = 256
"""Side in pixels."""

_SUN = np.array([-0.55, -0.65, 0.53])
"""Direction towards the light: x right, y down, z towards the viewer."""

_BALLS = (
    # Centre (x, y) and radius in pixels, and colour in linear light.
    ((82.0, 132.0), 44.0, (0.62, 0.05, 0.03)),
    ((166.0, 120.0), 52.0, (0.80, 0.33, 0.02)),
    ((126.0, 176.0), 38.0, (0.36, 0.50, 0.06)),
    ((206.0, 182.0), 27.0, (0.20, 0.03, 0.16)),
)


def fruit(samples: int) -> np.ndarray:
    """The picture in linear light, `[256 samples, 256 samples, 3]`."""
    y, x = (np.mgrid[: SIDE * samples, : SIDE * samples] + 0.5) / samples
    image = np.where((y < 118)[..., None], _wall(x, y), _cloth(x, y))
    for (cx, cy), radius, _ in _BALLS:
        image = image * _shadow(x, y, cx, cy, radius)[..., None]
    for (cx, cy), radius, color in _BALLS:
        off = np.hypot(x - cx, y - cy)
        inside = off < radius
        image = np.where(inside[..., None], _ball(x - cx, y - cy, radius, color), image)
    return np.clip(image, 0, 1)


def _wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    light = np.exp(-(((x - 60) / 170) ** 2) - ((y - 30) / 120) ** 2)
    return (0.05 + 0.22 * light)[..., None] * np.array([0.75, 0.85, 1.0])


def _cloth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Squares seen at a slant, faded with distance."""
    depth = 60 / (y - 88).clip(1)
    across, along = (x - 128) * depth / 26, 9 * depth
    square = (np.floor(across) + np.floor(along)) % 2
    thread = 0.04 * np.sin(40 * across) * np.sin(40 * along)
    white, blue = np.array([0.75, 0.72, 0.66]), np.array([0.10, 0.17, 0.36])
    color = np.where(square[..., None] > 0, white, blue) * (1 + thread[..., None])
    return color * (0.55 + 0.45 * np.exp(-(((x - 80) / 200) ** 2)))[..., None]


def _shadow(x: np.ndarray, y: np.ndarray, cx: float, cy: float, radius: float) -> np.ndarray:
    """The share of light that a ball does not block."""
    u, v = x - cx - 0.75 * radius, y - cy - 0.8 * radius
    off = np.hypot(u / 1.25, v / 0.42) / radius
    return 1 - 0.72 / (1 + np.exp(12 * (off - 0.95)))


def _ball(
    u: np.ndarray, v: np.ndarray, radius: float, color: tuple[float, float, float]
) -> np.ndarray:
    z = np.sqrt(np.maximum(radius**2 - u**2 - v**2, 0))
    normal = np.stack([u, v, z], -1) / radius
    lit = np.clip(normal @ _SUN, 0, 1)
    half = _SUN + np.array([0, 0, 1.0])
    shine = np.clip(normal @ (half / np.linalg.norm(half)), 0, 1) ** 60
    bounce = 0.10 * np.clip(normal[..., 1], 0, 1)
    # The hollow around the stalk, and specks on the skin.
    hollow = 1 - 0.5 * np.exp(-((u / radius) ** 2 + (v / radius + 0.75) ** 2) / 0.02)
    specks = 1 + 0.06 * np.sin(0.9 * u + 3 * np.sin(0.31 * v)) * np.sin(1.1 * v)
    body = (0.05 + 0.95 * lit + bounce) * hollow * specks
    return body[..., None] * np.array(color) + 0.6 * shine[..., None]
