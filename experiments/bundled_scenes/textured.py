"""The bundled scenes about texture filtering, and their textures."""

from collections.abc import Callable

import numpy as np

from softras2d.scenes import SIZE
from softras2d.scenes.palette import BLUE, INK, ORANGE, PAPER, SKY, VERMILION, mix

from .drawing import document, number, page


def _painted(index: np.ndarray, colors: list[str]) -> np.ndarray:
    """Look up indices `[height, width]` in a list of colours: `[height, width, 3]` in 0..1."""
    table = np.stack([mix([color], 0.0) for color in colors]) / 255
    return table[index].astype(np.float32)


def _centered(size: int) -> tuple[np.ndarray, np.ndarray]:
    """x `[1, size]` and y `[size, 1]` of the texels' centres, from the middle."""
    along = np.arange(size) + 0.5 - size / 2
    return along[None, :], along[:, None]


def sunflower() -> np.ndarray:
    """A flower whose seeds are some 3 texels wide; 256 x 256.

    **Source** of the seeds' spiral: Vogel, *A better way to construct the sunflower head* (1979).
    """
    x, y = _centered(256)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    index = np.zeros((256, 256), int)
    for petals, turn, reach, color in ((21, 0.5, 122.0, 1), (21, 0.0, 112.0, 2)):
        # Distance from the middle of the nearest petal, -1..1 over its width.
        across = (angle * petals / (2 * np.pi) + turn + 0.5) % 1.0 * 2 - 1
        edge = 60.0 + (reach - 60.0) * np.sqrt(1 - np.abs(across) ** 1.5)
        index[radius < edge] = color
        # A dark line between neighbours, and one along the middle.
        index[(radius < edge) & (np.abs(across) > 0.86)] = 5
        index[(radius < edge - 14) & (np.abs(across) < 0.08)] = 5
    index[radius < 66] = 3
    n = np.arange(330)
    seeds = 3.5 * np.sqrt(n), n * np.pi * (3 - np.sqrt(5))
    for r, turn in zip(*seeds, strict=True):
        near = np.hypot(x - r * np.cos(turn), y - r * np.sin(turn)) < 1.9
        index[near] = 4
    return _painted(index, [SKY, "#c46f00", ORANGE, "#3b1c06", "#f2cf85", "#8a3c00"])


def zone_quarter() -> np.ndarray:
    """A quarter of a zone plate, whose middle is the corner at u = v = 0; 320 x 320.

    It has half a period per texel, the finest possible pattern, at each far border. Few grey levels
    make the file small.
    """
    size, steps = 320, 7
    along = np.arange(size) + 0.5
    wave = np.cos(np.pi * (along[None, :] ** 2 + along[:, None] ** 2) / (2 * size))
    return (np.rint((wave[..., None] + 1) / 2 * steps) / steps).astype(np.float32)


def kilim() -> np.ndarray:
    """Woven bands that run down the texture, from 2 texels wide to 40; 256 x 256."""
    y = np.arange(256)[:, None]
    # Width in texels and motif of each band as far as the middle; the rest is mirrored.
    bands = (
        (6, "a"), (4, "b"), (2, "c"), (2, "b"), (2, "c"), (2, "b"), (32, "zigzag"), (2, "b"),
        (2, "d"), (2, "b"), (2, "d"), (8, "a"), (3, "e"), (3, "b"), (3, "e"), (3, "b"),
        (4, "c"), (46, "diamonds"),
    )  # fmt: skip
    half = []
    for width, motif in bands:
        x = np.arange(width)[None, :]
        fold = np.abs(y % 32 - 15.5)
        if motif == "zigzag":
            column = (x + fold) // 6 % 4
            half.append(np.choose(column.astype(int), [1, 0, 2, 3]))
        elif motif == "diamonds":
            ring = (np.abs(width - 0.5 - x) + 1.5 * fold) // 6
            half.append(np.choose(ring.astype(int) % 5, [3, 1, 0, 2, 4]))
        else:
            half.append(np.full((256, width), "abcde".index(motif)))
    left = np.concatenate(half, axis=1)
    assert left.shape == (256, 128)
    return _painted(
        np.concatenate([left, left[:, ::-1]], axis=1), [INK, PAPER, VERMILION, ORANGE, BLUE]
    )


BOAT = """
SSSSSSOO
SSSWSSOO
SSSWWSSS
SSSWWWSS
SSSKSSSS
SKKKKKKS
BBVVVVBB
BBBBBBBB
"""
"""A texture of 8 x 8 texels by the initials of their colours."""


def boat() -> np.ndarray:
    """A boat before the sun; 8 x 8."""
    rows = BOAT.split()
    index = np.array([["SOWKVB".index(letter) for letter in row] for row in rows])
    return _painted(index, [SKY, ORANGE, PAPER, INK, VERMILION, BLUE])


PICTURES: dict[str, Callable[[], np.ndarray]] = {
    "sunflower": sunflower,
    "zone_quarter": zone_quarter,
    "kilim": kilim,
    "boat": boat,
}
"""The picture of each file in `textures`."""


def minified() -> str:
    """Rows of sunflowers, which shrink from 100 pixels to 6."""
    lines, bottom = [page(SKY)], 300.0
    for row, count in enumerate((3, 5, 7, 10, 14, 19, 26, 36, 50)):
        side = SIZE / count
        bottom -= side
        # Every other row is shifted by half a flower, and has one more.
        for k in range(count + row % 2):
            lines.append(_image("sunflower", (k - row % 2 / 2) * side, bottom, side))
    return document(
        "A detailed texture, drawn smaller and smaller: without mip levels it falls into noise.",
        lines,
    )


def zone_plate() -> str:
    """Four mirrored quarters, at the border twice as fine as pixels can represent."""
    lines = [
        _image("zone_quarter", 0.0, 0.0, SIZE / 2, f"translate(150 150) scale({x} {y})")
        for x, y in ((-1, -1), (1, -1), (-1, 1), (1, 1))
    ]
    return document(
        "A zone plate, minified until its finest waves are shorter than two pixels: moire.", lines
    )


def stretched() -> str:
    """Slanted copies of the kilim, each 420 pixels long, from 110 pixels wide to 8."""
    lines = ['<texture texid="kilim" filename="textures/kilim.png"/>']
    along = np.array([np.cos(np.radians(-30.0)), np.sin(np.radians(-30.0))])
    down = np.array([-along[1], along[0]])
    corner = np.array([SIZE / 2, SIZE / 2]) - 210 * along - 205 * down
    for width in 112.0 * 0.75 ** np.arange(10):
        a, b = corner, corner + 420 * along
        corner = corner + width * down
        c, d = corner + 420 * along, corner
        lines.append(_textri((a, b, c), "0 0 1 0 1 1"))
        lines.append(_textri((a, c, d), "0 0 1 1 0 1"))
    return document(
        "A texture squeezed along one slanted axis: isotropic mip levels blur the other one too.",
        lines,
    )


def magnified() -> str:
    """A large boat, its mirror image, and two small ones, turned and sheared."""
    lines = [
        page(PAPER),
        _image("boat", 14.0, 14.0, 168.0),
        _image("boat", 0.0, 0.0, 84.0, "translate(14 286) scale(2 -1)"),
        _image("boat", 0.0, 0.0, 66.0, "translate(228 26) rotate(24)"),
        _image("boat", 0.0, 0.0, 80.0, "matrix(0.9 0.16 -0.4 1 226 152)"),
    ]
    return document("A texture of 8 x 8 texels drawn large: steps, or ramps between texels.", lines)


def _image(name: str, x: float, y: float, side: float, transform: str = "") -> str:
    """An image element with the picture in a square."""
    box = f'x="{number(x, 2)}" y="{number(y, 2)}"'
    side_text = number(side, 2)
    moved = f' transform="{transform}"' if transform else ""
    return (
        f'<image href="textures/{name}.png" {box} width="{side_text}" height="{side_text}"{moved}/>'
    )


def _textri(points: tuple[np.ndarray, ...], uvs: str) -> str:
    numbers = " ".join(number(value, 2) for point in points for value in point.tolist())
    return f'<textri points="{numbers}" uvs="{uvs}" texid="kilim"/>'
