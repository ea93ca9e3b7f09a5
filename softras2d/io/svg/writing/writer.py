"""Writes scenes as SVG files that `read_svg` reads back, without loss unless they are rounded.

Flat triangles become polygons, which any browser shows. Triangles with corner colours or textures
become the additional elements `colortri` and `textri`, which only `read_svg` knows. Unless
`digits` are given, every number is read back as the same float32.
"""

import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float32

from ....color import unpremultiply
from ....scene import Scene
from ....texture.pyramid import TexturePyramid
from ...drafts import atomic_file
from ..reading.control_points import SvgControls
from .arguments import check_canvas, check_digits, check_scene
from .browsers import elements_for_browsers
from .compact import compact_elements, short_elements

_POLYGON = '<polygon points="{},{} {},{} {},{}" {}/>'
_COLORTRI = '<colortri points="{} {} {} {} {} {}" colors="{}"/>'
_TEXTRI = '<textri points="{} {} {} {} {} {}" uvs="{}" texid="{}"/>'


def write_svg(
    path: str | os.PathLike[str],
    scene: Scene | SvgControls,
    *,
    height: int | None = None,
    width: int | None = None,
    fallback: bool = False,
    digits: int | None = None,
) -> None:
    """Write `scene` as an SVG file of `width` x `height` pixels that `read_svg` reads back.

    `SvgControls` are written as the file from which they were read, with their `points` in place of
    the control points of the file. `height`, `width` and `fallback` must then be left out, and
    `digits` has no effect. The rest of this text is about a `Scene`, for which `height` and `width`
    must be given, in pixels.

    - A triangle whose corners have equal colours becomes a `<polygon>` without stroke. Its fill is
      `rgb(p% p% p%)`, or `color(srgb r g b)` for colours outside 0..1; its alpha is `fill-opacity`.
    - A triangle with corner colours becomes a `<colortri>`, one with a texture a `<textri>`.
      Browsers show neither.
    - The base level of each texture is written beside the file as `STEM_texture0.png`, ..., with 8
      bits per channel if that is exact, else with 16.
    - A background other than white becomes a `<rect>` over the whole canvas before all triangles.

    `fallback=True` lets browsers show corner colours approximately. Before each `<colortri>` comes
    a path with the nearest linear gradient. A second path, for opaque triangles only, corrects
    colour errors of more than 8/255 (`browser_gradients.VISIBLE`). `in_browsers` gives the scene
    that browsers then show.

    `digits` makes the file small: coordinates are rounded to so many decimals, 0 to 6, colours of
    triangles to 8 bits, and their alpha to 1/1000. Flat triangles then become paths with relative
    coordinates. Triangles without area may be left out. Triangles of one colour share a path,
    unless another triangle that is drawn between them may touch them; `read_svg` may cut such a
    path into other triangles. If the file has seam lines, corner colours or textures, each triangle
    is still an element.

    Antialiasing in browsers lets the background show between triangles that share an edge. Lines in
    the colours of opaque triangles, drawn below them, hide it. If the triangles tile the canvas, a
    style sheet also makes browsers add up their coverage (`seams.py`). Elements that are for
    browsers alone have the attribute `data-fallback`, or lie in an element that has it, and both
    dialects of `read_svg` skip them.

    Without `digits`, `read_svg` gives the same triangles in the same order, with bitwise equal
    float32 numbers, in the smallest structure that can represent them. Vertices are not shared.
    There is one colour per triangle if that suffices, and three channels if everything is opaque.
    Textures are numbered by first use. A translucent background comes back as triangles over white,
    since an SVG has no background.

    Files are written completely or not at all. Raises `ValueError`, and writes nothing, for a batch
    of scenes, for values that are invalid or not finite in float32, for `height`, `width` or
    `digits` out of range, for a folder that does not exist, and for what SVG cannot represent:
    `depth`, `inverse_w`, textured triangles that are not white, textures that do not clamp or have
    addressing other than `"half_texel"`, and texels outside 0..1.
    """
    path = Path(path)
    if isinstance(scene, SvgControls):
        if height is not None or width is not None or fallback:
            raise ValueError("`height`, `width` and `fallback` are not for control points.")
        text = scene.text()
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return
    if digits is not None:
        check_digits(digits)
    if height is None or width is None:
        raise ValueError(f"`height` and `width` must be given; got {height} and {width}.")
    _check(path, scene, height, width)
    images = {} if scene.textures is None else _base_levels(path.stem, scene.textures)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">',
        *_background_elements(scene, height, width),
        *(
            f'<texture texid="{index}" filename={quoteattr(name)}/>'
            for index, name in enumerate(images)
        ),
        *_triangle_elements(scene, fallback, height, width, digits),
        "</svg>\n",
    ]
    # Textures first, so that whoever sees the SVG also finds the files that it names.
    for name, image in images.items():
        _write_png(path.with_name(name), image)
    with atomic_file(path) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def _check(path: Path, scene: Scene, height: int, width: int) -> None:
    """Raise `ValueError` for arguments of `write_svg` that cannot be written."""
    check_canvas(height, width)
    if not path.parent.is_dir():
        raise ValueError(f"{path}: the folder to write to does not exist.")
    check_scene(scene, absent=("depth", "inverse_w"))
    if scene.textures is not None:
        _check_textures(scene, scene.textures)


def _check_textures(scene: Scene, textures: TexturePyramid) -> None:
    """Raise `ValueError` for textures, or colours of textured triangles, that SVG cannot hold."""
    # `read_svg` builds every `texture` element with these settings.
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
        index = int(np.argmax(tinted))
        raise ValueError(f"textured triangles must be white in an SVG; triangle {index} is not.")


def _background_elements(scene: Scene, height: int, width: int) -> list[str]:
    """The `<rect>` of the background in a list; no element for opaque white.

    `read_svg` assumes white. The rect covers the canvas of `height` x `width` pixels.
    """
    background = _float32(scene.background)
    if (background == 1).all():
        return []
    paint = _paint_attributes(background[None])[0]
    return [f'<rect x="0" y="0" width="{width}" height="{height}" {paint}/>']


def _triangle_elements(
    scene: Scene, fallback: bool, height: int, width: int, digits: int | None
) -> list[str]:
    """The elements of all triangles as text, in draw order, with those for browsers around them.

    The arguments are as for `write_svg`.
    """
    colors = _float32(scene.colors)
    corners = _float32(scene.positions)[np.asarray(scene.triangles)]
    if digits is not None:
        # The shortest decimal of a rounded number is short.
        corners = np.round(corners.astype(np.float64), digits).astype(np.float32)
        colors = _round_colors(colors)
    points = corners.reshape(-1, 6)
    is_flat = (colors == colors[:, :1]).all(axis=(1, 2))
    is_textured = np.zeros(len(is_flat), bool)
    if scene.texture_index is not None:
        is_textured = np.asarray(scene.texture_index) >= 0
    lines = np.empty(len(is_flat), object)
    is_polygon = is_flat & ~is_textured
    if digits is None:
        paints = _paint_attributes(colors[is_polygon, 0])
        lines[is_polygon] = _elements(_POLYGON, points[is_polygon], paints)
    else:
        lines[is_polygon] = short_elements(corners[is_polygon], colors[is_polygon, 0], digits)
    is_shaded = ~is_flat & ~is_textured
    corner_colors = _number_lists(_with_alpha(colors[is_shaded]))
    lines[is_shaded] = _elements(_COLORTRI, points[is_shaded], corner_colors)
    if scene.uv is not None and scene.texture_index is not None:
        uvs = _number_lists(_float32(scene.uv)[is_textured])
        indices = np.asarray(scene.texture_index)[is_textured].tolist()
        lines[is_textured] = _elements(_TEXTRI, points[is_textured], uvs, indices)
    extra = elements_for_browsers(corners, colors, is_polygon, is_shaded & fallback, height, width)
    if digits is not None and is_polygon.all() and not any(extra):
        return compact_elements(corners, colors[:, 0], digits)
    for index, elements in extra.before.items():
        lines[index] = elements + "\n" + lines[index]
    return [*extra.head, *lines.tolist(), *extra.tail]


def _round_colors(
    colors: Float32[np.ndarray, "triangles corners channels"],
) -> Float32[np.ndarray, "triangles corners channels"]:
    """Round colours to multiples of 1/255, and alpha, if there is one, to multiples of 1/1000."""
    levels = np.array([255, 255, 255, 1000], np.float32)[: colors.shape[-1]]
    return np.rint(colors * levels) / levels


def _elements(
    template: str, points: Float32[np.ndarray, "triangles 6"], *attributes: list
) -> list[str]:
    """Make the text of one element per triangle, by `str.format` of `template`.

    The template is filled with the six coordinates of the triangle, as shortest decimals, and then
    with its attributes. Each of `attributes` is a list with one text or number per triangle.
    """
    return list(map(template.format, *_shortest(points).T, *attributes))


def _number_lists(values: Float32[np.ndarray, "triangles *shape"]) -> list[str]:
    """For each triangle, all of its numbers as shortest decimals in one text, with blanks between.

    Numbers are in the order of the array.
    """
    count = int(np.prod(values.shape[1:]))
    return list(map(" ".join, _shortest(values.reshape(-1, count)).tolist()))


def _with_alpha(
    colors: Float32[np.ndarray, "triangles colors channels"],
) -> Float32[np.ndarray, "triangles colors 4"]:
    """Append an alpha of 1 to colours of three channels; those of four are returned unchanged."""
    alpha = np.ones((*colors.shape[:2], 4 - colors.shape[2]), np.float32)
    return np.concatenate([colors, alpha], axis=-1)


def _paint_attributes(colors: Float32[np.ndarray, "colors channels"]) -> list[str]:
    """For each colour of 3 or 4 channels, the attributes that fill an element with it, as text.

    They are `fill`, and `fill-opacity` if alpha is not 1. All numbers are read back as the same
    float32.
    """
    rgb = colors[:, :3]
    fills = list(map('fill="rgb({}% {}% {}%)"'.format, *_percent(rgb).T))
    # `rgb()` would clip colours outside 0..1 (CSS Color 4).
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
    """Convert an array to float32 on the host; numbers beyond float32 become infinite."""
    # Numbers beyond float32 become infinite, which `check_scene` refuses.
    with np.errstate(over="ignore"):
        return np.asarray(value).astype(np.float32)


def _shortest(values: Float32[np.ndarray, "*shape"]) -> np.ndarray:
    """The shortest decimals that are read as the same float32, as an array of strings.

    numpy computes them by the algorithm Dragon4.
    """
    texts = [text.removesuffix(".0") for text in values.astype(str).ravel().tolist()]
    return np.array(texts, object).reshape(values.shape)


def _percent(values: Float32[np.ndarray, "*shape"]) -> np.ndarray:
    """Decimals of 100 times each value, as an array of strings of the same shape.

    Each string p satisfies float32(p / 100) = value, where the division is in float64. The shortest
    decimal of a float32 has at most nine digits, and so has 100 times that decimal.
    """
    shortest = values.astype(str).astype(np.float64).ravel() * 100.0
    texts = [f"{percent:.10g}" for percent in shortest.tolist()]
    read_back = (np.array(texts, np.float64) / 100.0).astype(np.float32)
    # If a decimal is almost halfway between two floats, the division may round it to the wrong one.
    # 100 times a float32 is exact in float64, so dividing that by 100 gives the float32.
    for index in np.flatnonzero(read_back != values.ravel()):
        texts[index] = repr(float(values.ravel()[index]) * 100.0)
    return np.array(texts, object).reshape(values.shape)


def _base_levels(stem: str, textures: TexturePyramid) -> dict[str, np.ndarray]:
    """The base level of each texture, `[height, width, 3 or 4]`, by the name of its file.

    Values are in 0..1 with straight alpha. `stem` is the name of the SVG file without its suffix;
    texture k gets the name `STEM_texturek.png`.
    """
    texels, images = np.asarray(textures.texels), {}
    for index, (offset, height, width) in enumerate(np.asarray(textures.levels)[:, 0].tolist()):
        base = unpremultiply(texels[offset : offset + height * width].reshape(height, width, -1))
        images[f"{stem}_texture{index}.png"] = np.minimum(base, 1.0)
    return images


def _write_png(path: Path, image: np.ndarray) -> None:
    """Write a texture in 0..1 as PNG, with 8 bits per channel if that is exact to 1e-6, else 16.

    `image` is `[height, width, 3 or 4]` with straight alpha. Raises `ValueError` if the file cannot
    be written.
    """
    # Imported here, since scenes without textures need no image library.
    import OpenImageIO as oiio

    levels = np.rint(image * 255.0)
    is_exact = np.abs(levels / 255.0 - image).max() < 1e-6
    pixels = levels.astype(np.uint8) if is_exact else np.rint(image * 65535.0).astype(np.uint16)
    height, width, channels = image.shape
    spec = oiio.ImageSpec(width, height, channels, str(pixels.dtype))
    # PNG holds straight alpha.
    spec.attribute("oiio:UnassociatedAlpha", 1)
    with atomic_file(path) as temporary:
        output = oiio.ImageOutput.create("png")
        assert output is not None, "OpenImageIO without PNG"
        is_written = output.open(str(temporary), spec) and output.write_image(pixels)
        if not (output.close() and is_written):
            raise ValueError(f"{path}: cannot be written: {output.geterror()}")
