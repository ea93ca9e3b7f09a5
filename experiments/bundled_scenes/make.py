"""Write the bundled scenes: `python -m experiments.bundled_scenes.make [FOLDER]`.

The files are in `softras2d/scenes`, so that scenes can be read without this script. A test checks
that the script still writes the same files.
"""

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np

from softras2d import scenes
from softras2d.io.images import write_image
from softras2d.scenes import SIZE
from softras2d.scenes.palette import BLUE, INK, ORANGE, PAPER, SKY, VERMILION, mix

from .drawing import code, document, number, page, polar, polygon
from .textured import PICTURES, magnified, minified, stretched, zone_plate

# Right ascension in hours, declination in degrees and magnitude of the stars of each constellation,
# in drawing order; rounded to a tenth of a degree, which is enough for a picture.
FIGURES = {
    "Ursa Major": (
        (13.79, 49.3, 1.9), (13.40, 54.9, 2.2), (12.90, 56.0, 1.8), (12.26, 57.0, 3.3),
        (11.06, 61.8, 1.8), (11.03, 56.4, 2.4), (11.90, 53.7, 2.4), (12.26, 57.0, 3.3),
    ),
    "Ursa Minor": (
        (2.53, 89.3, 2.0), (17.54, 86.6, 4.4), (16.77, 82.0, 4.2), (15.73, 77.8, 4.3),
        (14.85, 74.2, 2.1), (15.35, 71.8, 3.0), (16.29, 75.8, 5.0), (15.73, 77.8, 4.3),
    ),
    "Cassiopeia": (
        (0.15, 59.1, 2.3), (0.68, 56.5, 2.2), (0.95, 60.7, 2.2), (1.43, 60.2, 2.7),
        (1.91, 63.7, 3.4),
    ),
    "Cepheus": (
        (21.31, 62.6, 2.4), (21.48, 70.6, 3.2), (23.66, 77.6, 3.2), (22.83, 66.2, 3.5),
        (22.18, 58.2, 3.4), (21.31, 62.6, 2.4),
    ),
    "Draco": (
        (17.51, 52.3, 2.8), (17.94, 51.5, 2.2), (17.89, 56.9, 3.7), (17.54, 55.2, 4.9),
        (17.51, 52.3, 2.8), (17.89, 56.9, 3.7), (19.21, 67.7, 3.1), (18.35, 72.7, 3.6),
        (17.15, 65.7, 3.2), (16.40, 61.5, 2.7), (16.03, 58.6, 4.0), (15.42, 59.0, 3.3),
        (14.07, 64.4, 3.7), (12.56, 69.8, 3.9), (11.52, 69.3, 3.8),
    ),
}  # fmt: skip


def hairlines() -> str:
    """The northern sky, in the SVG dialect of a course: lines and points stay one pixel wide."""
    rim = 138.0
    lines = [
        f'<rect x="0" y="0" width="{SIZE}" height="{SIZE}" fill="{PAPER}"/>',
        polygon(polar(rim + 6, np.arange(72) * 5.0), f'fill="{ORANGE}"', 1),
        polygon(polar(rim + 4, np.arange(72) * 5.0), f'fill="{INK}"', 1),
    ]
    for radius in (rim / 3, 2 * rim / 3, rim):
        lines.append(_polyline(polar(radius, np.arange(0.0, 361.0, 6.0)), "#3b5f87"))
    for hour in range(0, 24, 2):
        (x1, y1), (x2, y2) = polar(np.array([10.0, rim]), np.full(2, hour * 15.0)).round(1).tolist()
        lines.append(f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="#274a72"/>')
    random = np.random.default_rng(1)
    for radius, angle in zip(
        rim * np.sqrt(random.random(110)), random.random(110) * 360, strict=True
    ):
        shade = code(mix(["#5f7ea3", "#dbe7f3"], random.random()))
        ((x, y),) = polar(np.array([radius]), np.array([angle])).round(1).tolist()
        lines.append(f'<rect x="{x:g}" y="{y:g}" width="0" height="0" fill="{shade}"/>')
    for stars in FIGURES.values():
        lines.append(_polyline(_sky(np.array(stars), rim), SKY))
    for stars in FIGURES.values():
        for star in sorted(set(stars)):
            lines.append(_star(_sky(np.array([star]), rim)[0], star[2]))
    return document(
        "Points and hairlines of the course dialect stay one pixel wide and hard at every rate, "
        "while the stars and the rim become smooth.",
        lines,
    )


def _sky(stars: np.ndarray, rim: float) -> np.ndarray:
    """Azimuthal equidistant projection about the pole.

    Declination 40 is at the distance `rim` from the middle; hours turn counterclockwise.
    """
    return polar((90.0 - stars[:, 1]) / 50.0 * rim, -15.0 * stars[:, 0])


def _star(middle: np.ndarray, magnitude: float) -> str:
    """A four-pointed star, larger for a brighter star (a lower magnitude)."""
    long, short = 7.5 - 1.2 * magnitude, 1.6 - 0.2 * magnitude
    radius = np.where(np.arange(8) % 2 == 0, long, short)
    rays = polar(radius, np.arange(8) * 45.0) - SIZE / 2
    return polygon(middle + rays, 'fill="#fff4d6"', 1)


def _polyline(points: np.ndarray, stroke: str) -> str:
    pairs = " ".join(f"{number(x, 1)},{number(y, 1)}" for x, y in points.tolist())
    return f'<polyline points="{pairs}" fill="none" stroke="{stroke}"/>'


def slivers() -> str:
    """Needles that point out of a ring and into it, in two alternating colours."""
    count, base, half = 84, 58.0, 1.7
    lines = [page(INK)]
    for index in range(count):
        angle, odd = 360.0 * index / count, index % 2
        spread = np.degrees(half / base)
        sides = np.array([angle - spread, angle, angle + spread])
        outer = polar(np.array([base, 118.0 if odd else 146.0, base]), sides)
        inner = polar(np.array([base, 24.0 if odd else 8.0, base]), sides)
        lines.append(polygon(outer, f'fill="{SKY if odd else "#fbe3b0"}"'))
        lines.append(polygon(inner, f'fill="{VERMILION if odd else ORANGE}"'))
    return document("Slivers whose tips break into dashes at one sample per pixel.", lines)


def wheel() -> str:
    """A colour wheel: light in the middle, saturated on a ring, dark outside."""
    blades, twist = 36, 24.0
    lines = [page("#10141f")]
    angles = np.arange(blades + 1) * 360.0 / blades
    rings = [
        (polar(28.0, angles - twist), 0.97, 0.02),
        (polar(72.0, angles), 0.84, 0.10),
        (polar(112.0, angles + twist), 0.68, 0.15),
        (polar(142.0, angles + 1.4 * twist), 0.30, 0.06),
    ]
    for (near, near_light, near_chroma), (far, far_light, far_chroma) in pairwise(rings):
        for i, (first, second) in enumerate(pairwise(angles.tolist())):
            a, b = oklch(near_light, near_chroma, first), oklch(near_light, near_chroma, second)
            c, d = oklch(far_light, far_chroma, first), oklch(far_light, far_chroma, second)
            lines.append(_colortri([near[i], far[i], far[i + 1]], [a, c, d]))
            lines.append(_colortri([near[i], far[i + 1], near[i + 1]], [a, d, b]))
    return document("A colour wheel of triangles whose corner colours are interpolated.", lines)


def _colortri(points: list[np.ndarray], colors: list[np.ndarray]) -> str:
    numbers = " ".join(number(value, 2) for point in points for value in point.tolist())
    rgba = " ".join(" ".join(number(v, 3) for v in color.tolist()) + " 1" for color in colors)
    return f'<colortri points="{numbers}" colors="{rgba}"/>'


def oklch(lightness: float, chroma: float, hue: float) -> np.ndarray:
    """Display RGB in 0..1 of a colour in OKLCh, hue in degrees; clipped to the gamut.

    **Source:** Ottosson, *A perceptual color space for image processing* (2020).
    """
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    to_cone = np.array(
        [
            [1.0, 0.3963377774, 0.2158037573],
            [1.0, -0.1055613458, -0.0638541728],
            [1.0, -0.0894841775, -1.2914855480],
        ]
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(to_rgb @ (to_cone @ np.array([lightness, a, b])) ** 3, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def rings() -> str:
    """A zone plate: ring n ends at radius sqrt(n), so rings and the gaps between cover equal areas.

    Its frequency grows with the radius, to one ring per pixel at the rim.
    """
    rim, edges = 145.0, 144
    lines = [page(PAPER), '<g fill="none" stroke-linejoin="bevel">']
    radii = rim * np.sqrt(np.arange(edges + 1) / edges)
    for inner, outer in zip(radii[1::2], radii[2::2], strict=True):
        # Enough corners that the polygon stays within a tenth of a pixel of the circle.
        corners = int(np.ceil(np.pi / np.sqrt(2 * 0.1 / outer)))
        shade = code(mix([VERMILION, "#7a3b69", BLUE, INK], outer / rim))
        width = number(outer - inner, 3)
        ring = polar((inner + outer) / 2, np.arange(corners) * 360.0 / corners)
        lines.append(polygon(ring, f'stroke="{shade}" stroke-width="{width}"', 1))
    lines.append("</g>")
    return document("Concentric rings that make moire at one sample per pixel.", lines)


def glass() -> str:
    """Tumbling blocks of translucent triangles over a moon and stripes."""
    side = 29.0
    lines = [page(PAPER)]
    for top in range(25, SIZE, 50):
        lines.append(f'<rect x="0" y="{top}" width="{SIZE}" height="25" fill="#e6d5b8"/>')
    moon = polar(92.0, np.arange(64) * 5.625) + np.array([28.0, -30.0])
    lines.append(polygon(moon, f'fill="{INK}"'))
    hexagon = polar(side, np.arange(6) * 60.0) - SIZE / 2
    faces = (("#ffffff", 0.7), (BLUE, 0.6), (SKY, 0.6))
    for row in range(-2, 3):
        for column in range(5 - abs(row)):
            shift = column - (4 - abs(row)) / 2
            middle = SIZE / 2 + side * np.array([shift * np.sqrt(3.0), 1.5 * row])
            warm = (row + 2 * column) % 3 == 0
            for face, (tint, alpha) in enumerate(faces):
                tint = ORANGE if warm and face == 0 else tint
                for k in (2 * face - 1, 2 * face):
                    points = middle + np.stack([np.zeros(2), hexagon[k % 6], hexagon[(k + 1) % 6]])
                    lines.append(polygon(points, f'fill="{tint}" fill-opacity="{alpha}"'))
    return document("Translucent triangles that abut: no seam may show between them.", lines)


COLUMNS, ROWS = 30, 25
"""Cells of the landscape, two triangles each."""

RIDGES = (
    (156.0, 26.0, 1.0, "#8fa3bf", "#6f86a8"),
    (204.0, 22.0, 2.3, "#4f6f99", "#3a5a86"),
    (236.0, 17.0, 4.1, "#274a72", "#1a3759"),
    (272.0, 10.0, 5.2, "#12304f", "#0a1c30"),
)
"""Height, relief, phase, and colours of crest and foot of each range, the farthest first."""


def mesh() -> str:
    """Mountains at dusk: a jittered grid whose vertices are moved to the ridges."""
    random = np.random.default_rng(4)
    grid = _grid(random)
    lines = [page("#274a72")]
    for row in range(ROWS):
        for column in range(COLUMNS):
            a, b = grid[row, column], grid[row, column + 1]
            c, d = grid[row + 1, column], grid[row + 1, column + 1]
            falling = _layer((a + b + d) / 3) != _layer((a + c + d) / 3)
            rising = _layer((a + b + c) / 3) != _layer((b + c + d) / 3)
            # Take the diagonal that separates two ranges, or either one if neither does.
            if falling or (not rising and random.random() < 0.5):
                halves = ([a, b, d], [a, d, c])
            else:
                halves = ([a, b, c], [b, d, c])
            for half in halves:
                points = np.stack(half)
                shade = _landscape(points.mean(axis=0)) * (1.0 + 0.05 * random.standard_normal())
                lines.append(polygon(points, f'fill="{code(shade)}"', 1))
    return document("A mesh of 1,500 small triangles.", lines)


def _ridge(layer: int, x: float | np.ndarray) -> np.ndarray:
    height, relief, phase, _, _ = RIDGES[layer]
    t = np.asarray(x) / SIZE * 2 * np.pi
    waves = np.sin(1.3 * t + phase) + 0.5 * np.sin(3.1 * t + 2.7 * phase)
    return np.asarray(height - relief * (0.8 * waves + 0.5 * np.abs(np.sin(2.2 * t + 1.7 * phase))))


def _grid(random: np.random.Generator) -> np.ndarray:
    """Jittered vertices `[rows + 1, columns + 1, 2]`; border vertices stay on the border."""
    y, x = np.meshgrid(np.arange(ROWS + 1.0), np.arange(COLUMNS + 1.0), indexing="ij")
    jitter = 0.5 * (random.random((2, ROWS + 1, COLUMNS + 1)) - 0.5)
    jitter[0, :, [0, -1]] = 0.0
    jitter[1, [0, -1], :] = 0.0
    x = (x + jitter[0]) * (SIZE / COLUMNS)
    y = (y + jitter[1]) * (SIZE / ROWS)
    for column in range(COLUMNS + 1):
        # From the nearest range back. Ranges that are hidden or close above another move no vertex.
        nearest = float(SIZE)
        for layer in reversed(range(len(RIDGES))):
            row = 1 + int(np.argmin(np.abs(y[1:-1, column] - _ridge(layer, x[1:-1, column]))))
            crest = float(_ridge(layer, x[row, column]))
            if crest < nearest - 8.0:
                y[row, column] = nearest = crest
    return np.stack([x, np.sort(y, axis=0)], axis=-1)


def _layer(point: np.ndarray) -> int:
    """The nearest range that covers the point; -1 is the sky."""
    covers = [k for k in range(len(RIDGES)) if point[1] > _ridge(k, point[0])]
    return covers[-1] if covers else -1


def _landscape(point: np.ndarray) -> np.ndarray:
    layer = _layer(point)
    if layer >= 0:
        below = point[1] - _ridge(layer, point[0])
        return mix(list(RIDGES[layer][3:]), below / 45.0)
    sky = mix(["#1f3a66", "#5b5f94", "#b8718a", "#ef9a6c", "#f8d08f"], point[1] / 172.0)
    away = np.hypot(*(point - np.array([196.0, 92.0])))
    if away < 34.0:
        return mix(["#fff3cf", "#fde0a0"], away / 34.0)
    glow = 0.5 * np.exp(-(away - 34.0) / 30.0)
    return (1.0 - glow) * sky + glow * mix(["#fde0a0"], 0.0)


MADE: dict[str, Callable[[], str]] = {
    "hairlines": hairlines,
    "slivers": slivers,
    "wheel": wheel,
    "rings": rings,
    "glass": glass,
    "mesh": mesh,
    "minified": minified,
    "zone_plate": zone_plate,
    "stretched": stretched,
    "magnified": magnified,
}
"""The text of each file."""


def write(folder: Path) -> None:
    """Write the files of `MADE`, and those of `PICTURES` into `textures`."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    for name, make in MADE.items():
        (folder / f"{name}.svg").write_text(make(), encoding="utf-8")
    for name, draw in PICTURES.items():
        write_image(folder / "textures" / f"{name}.png", draw())


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else scenes.path("hairlines").parent)
