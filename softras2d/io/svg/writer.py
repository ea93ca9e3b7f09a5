"""Writes scenes as SVG: flat triangles as polygons, which any browser shows, others in the dialect.

Numbers are the shortest decimals that give back the same float32.
"""

import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from ...color import unpremultiply
from ...scene import Scene, check
from ...texture.pyramid import TexturePyramid
from ..drafts import atomic_file
from .browsers import elements_for_browsers

_POLYGON = '<polygon points="{},{} {},{} {},{}" {}/>'
_COLORTRI = '<colortri points="{} {} {} {} {} {}" colors="{}"/>'
_TEXTRI = '<textri points="{} {} {} {} {} {}" uvs="{}" texid="{}"/>'


def write_svg(
    path: str | os.PathLike[str],
    scene: Scene,
    *,
    height: int,
    width: int,
    fallback: bool = False,
) -> None:
    """Write `scene` as an SVG file of `width` x `height` pixels that `read_svg` takes back.

    A triangle whose corners agree becomes a `<polygon>` without stroke: `fill="rgb(p% p% p%)"`,
    colours beyond 0..1 as `color(srgb r g b)`, alpha as `fill-opacity`. One with corner colours
    becomes a `<colortri>`, one with a texture a `<textri>`; browsers skip both. The base levels of
    textures are written beside the file as `STEM_texture0.png`, ...: 8 bits where that is exact,
    16 otherwise. A background other than white is a first `<rect>` over the whole canvas, with
    `fill-opacity` if it is translucent.

    `fallback=True` puts what browsers can draw before each `<colortri>`: the linear gradient
    nearest to its colours, and a second one where that lacks more than `gradients.VISIBLE`;
    `in_browsers` gives the scene that they show.

    Browsers show the background through the edges of triangles that abut. Below opaque ones that
    share an edge, lines of their colours hide it; triangles that tile the canvas are in a `<g>`
    whose style adds what they cover, where the browser can (`seams`). All that is there for
    browsers alone is marked `data-fallback`, which `read_svg` skips in both dialects.

    `read_svg` gives back the same triangles in the same order and every float32 of them, with the
    smallest structure that holds them: vertices are not shared, colours are flat if all triangles
    are, and of three channels if all are opaque, as is the background; textures are numbered by
    first use. A translucent background comes back as triangles over white, since a picture in SVG
    lies on a page.

    Files appear whole or not at all. Raises `ValueError`, and writes nothing, for a batch, for
    values that are not finite in float32, and for what the dialect cannot say: `depth`,
    `inverse_w`, colours of textured triangles, textures that do not clamp.
    """
    path = Path(path)
    _check(path, scene, height, width)
    images = {} if scene.textures is None else _images(path, scene.textures)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">',
        *_background(scene, height, width),
        *(
            f'<texture texid="{index}" filename={quoteattr(name)}/>'
            for index, name in enumerate(images)
        ),
        *_triangles(scene, fallback, height, width),
        "</svg>\n",
    ]
    # The pictures first: a file that is there has all that it names.
    for name, image in images.items():
        _write_png(path.with_name(name), image)
    with atomic_file(path) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def _check(path: Path, scene: Scene, height: int, width: int) -> None:
    """Refuse what cannot be written, in one line."""
    if min(height, width) < 1:
        raise ValueError(f"`height` and `width` must be positive; got {height} and {width}.")
    if scene.positions.ndim != 2:
        raise ValueError(f"`write_svg` takes one scene, not a batch; got {scene.positions.shape}.")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: the folder to write to does not exist.")
    for name in ("depth", "inverse_w"):
        if getattr(scene, name) is not None:
            raise ValueError(f"SVG cannot say `{name}`; the scene has it, `write_svg` wants None.")
    check(scene)
    for name in ("positions", "colors", "background", "uv"):
        value = getattr(scene, name)
        if value is not None and not np.isfinite(_float32(value)).all():
            raise ValueError(f"`{name}` must be finite in float32 to be written as SVG.")
    if scene.textures is not None:
        _check_textures(scene, scene.textures)


def _check_textures(scene: Scene, textures: TexturePyramid) -> None:
    # What `read_svg` builds from a `texture` element.
    if (textures.border, textures.addressing) != ("clamp", "half_texel"):
        raise ValueError(
            "SVG textures have border 'clamp' and addressing 'half_texel'; "
            f"got {textures.border!r} and {textures.addressing!r}."
        )
    texels = np.asarray(textures.texels)
    if not ((texels >= 0) & (texels <= 1)).all():
        raise ValueError("texels must be in 0..1 to be written as PNG.")
    textured = np.asarray(scene.texture_index) >= 0
    tinted = textured & (np.asarray(scene.colors) != 1).any(axis=(1, 2))
    if tinted.any():
        where = int(np.argmax(tinted))
        raise ValueError(
            f"SVG cannot say `colors` of a textured triangle; triangle {where} is not white."
        )


def _background(scene: Scene, height: int, width: int) -> list[str]:
    background = _float32(scene.background)
    if (background == 1).all():
        return []
    paint = _paint(background[None])[0]
    return [f'<rect x="0" y="0" width="{width}" height="{height}" {paint}/>']


def _triangles(scene: Scene, fallback: bool, height: int, width: int) -> list[str]:
    """The elements of all triangles, in draw order, with what browsers are given beside them."""
    colors = _float32(scene.colors)
    corners = _float32(scene.positions)[np.asarray(scene.triangles)]
    points = corners.reshape(-1, 6)
    flat = (colors == colors[:, :1]).all(axis=(1, 2))
    textured = np.zeros(len(flat), bool)
    if scene.texture_index is not None:
        textured = np.asarray(scene.texture_index) >= 0
    lines = np.empty(len(flat), object)
    plain = flat & ~textured
    lines[plain] = _rows(_POLYGON, points[plain], _paint(colors[plain, 0]))
    shaded = ~flat & ~textured
    lines[shaded] = _rows(_COLORTRI, points[shaded], _lists(_with_alpha(colors[shaded])))
    if scene.uv is not None and scene.texture_index is not None:
        uvs = _lists(_float32(scene.uv)[textured])
        indices = np.asarray(scene.texture_index)[textured].tolist()
        lines[textured] = _rows(_TEXTRI, points[textured], uvs, indices)
    beside = elements_for_browsers(corners, colors, plain, shaded & fallback, height, width)
    for index, elements in beside.before.items():
        lines[index] = elements + "\n" + lines[index]
    return [*beside.head, *lines.tolist(), *beside.tail]


def _rows(element: str, points: np.ndarray, *attributes: list) -> list[str]:
    """`element` filled with the six coordinates of each triangle, then its attributes."""
    return list(map(element.format, *_shortest(points).T, *attributes))


def _lists(values: np.ndarray) -> list[str]:
    """The numbers of each triangle `[n, ...]`, with blanks between."""
    row = int(np.prod(values.shape[1:]))
    return list(map(" ".join, _shortest(values.reshape(-1, row)).tolist()))


def _with_alpha(colors: np.ndarray) -> np.ndarray:
    alpha = np.ones((*colors.shape[:2], 4 - colors.shape[2]), np.float32)
    return np.concatenate([colors, alpha], axis=-1)


def _paint(colors: np.ndarray) -> list[str]:
    """The attributes that fill with each colour of `[n, 3 or 4]`."""
    rgb = colors[:, :3]
    fills = list(map('fill="rgb({}% {}% {}%)"'.format, *_percent(rgb).T))
    # What `rgb()` would clip: CSS Color 4, section 10.2.
    for row in np.flatnonzero(((rgb < 0) | (rgb > 1)).any(axis=1)):
        fills[row] = 'fill="color(srgb {} {} {})"'.format(*_shortest(rgb[row]))
    if colors.shape[1] == 3:
        return fills
    opacities = _shortest(colors[:, 3])
    return [
        fill if opacity == "1" else f'{fill} fill-opacity="{opacity}"'
        for fill, opacity in zip(fills, opacities, strict=True)
    ]


def _float32(value: object) -> np.ndarray:
    # Beyond float32 is infinite, which `_check` reports.
    with np.errstate(over="ignore"):
        return np.asarray(value).astype(np.float32)


def _shortest(values: np.ndarray) -> np.ndarray:
    """The shortest decimals that read back as the same float32 (numpy's Dragon4), as objects."""
    texts = [text.removesuffix(".0") for text in values.astype(str).ravel().tolist()]
    return np.array(texts, object).reshape(values.shape)


def _percent(values: np.ndarray) -> np.ndarray:
    """A hundred times as much, such that float32(percent / 100) is the value again.

    The shortest decimal has at most nine digits, and a hundred times it the same digits.
    """
    shortest = values.astype(str).astype(np.float64).ravel() * 100.0
    texts = [f"{value:.10g}" for value in shortest.tolist()]
    back = (np.array(texts, np.float64) / 100.0).astype(np.float32)
    # A decimal next to the middle of two floats may be rounded the other way by the division;
    # a hundred times a float32 is exact in float64, and so is its quotient.
    for index in np.flatnonzero(back != values.ravel()):
        texts[index] = repr(float(values.ravel()[index]) * 100.0)
    return np.array(texts, object).reshape(values.shape)


def _images(path: Path, textures: TexturePyramid) -> dict[str, np.ndarray]:
    """The base level of each texture `[height, width, 3 or 4]` by the name of its file."""
    texels, images = np.asarray(textures.texels), {}
    for index, (offset, height, width) in enumerate(np.asarray(textures.levels)[:, 0].tolist()):
        base = unpremultiply(texels[offset : offset + height * width].reshape(height, width, -1))
        images[f"{path.stem}_texture{index}.png"] = np.minimum(base, 1.0)
    return images


def _write_png(path: Path, image: np.ndarray) -> None:
    # Imported here: scenes without textures need no image library.
    import OpenImageIO as oiio

    byte = np.rint(image * 255.0)
    exact = np.abs(byte / 255.0 - image).max() < 1e-6
    pixels = byte.astype(np.uint8) if exact else np.rint(image * 65535.0).astype(np.uint16)
    height, width, channels = image.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8" if exact else "uint16")
    # PNG holds straight alpha.
    spec.attribute("oiio:UnassociatedAlpha", 1)
    with atomic_file(path) as temporary:
        output = oiio.ImageOutput.create("png")
        assert output is not None, "OpenImageIO without PNG"
        done = output.open(str(temporary), spec) and output.write_image(pixels)
        if not (output.close() and done):
            raise ValueError(f"{path}: cannot be written: {output.geterror()}")
