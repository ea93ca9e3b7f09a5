"""Images and textures in drawings: which files are read or refused, and what is drawn."""

import base64
import zlib

import numpy as np
import pytest

from softras2d.io import budget
from softras2d.io.svg.reading.reader import parse_svg, read_svg

from ....cases.drawings import corners_of
from ....cases.png_files import png

NS = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
PIXELS = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4) * 8
PIXELS[..., 3] = [[255, 128, 0], [255, 255, 255]]
BOX_CLIP = (
    '<clipPath id="c" clipPathUnits="objectBoundingBox"><rect width="{}" height="1"/></clipPath>'
)
"""A clip path that shows the left fraction `{}` of a bounding box."""


def png_of(pixels):
    """A PNG file with these pixels, bytes `[height, width, 3 or 4]`."""
    height, width, channels = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    return png(height, width, zlib.compress(rows), channels=channels)


def embedded(pixels):
    return "data:image/png;base64," + base64.b64encode(png_of(pixels)).decode()


@pytest.fixture
def folder(tmp_path):
    """A folder with `scenes/` (a scene and images), `img/` beside it, and a file above both."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "img").mkdir()
    (tmp_path / "scenes" / "a.png").write_bytes(png_of(PIXELS))
    (tmp_path / "scenes" / "my pic.png").write_bytes(png_of(PIXELS[..., :3]))
    (tmp_path / "img" / "map.png").write_bytes(png_of(PIXELS[..., :3].copy()))
    (tmp_path / "secret.png").write_bytes(png_of(PIXELS))
    return tmp_path


def read(folder, body, size='width="100" height="100"', **options):
    path = folder / "scenes" / "s.svg"
    path.write_text(f"<svg {NS} {size}>\n{body}\n</svg>")
    return read_svg(path, **options)


def textri(name, points="0 0 9 0 0 9"):
    return (
        f'<texture texid="t" filename="{name}"/><textri points="{points}" '
        'uvs="0 0 1 0 0 1" texid="t"/>'
    )


def textures(scene):
    assert scene.textures is not None
    return scene.textures


def premultiplied(pixels):
    """Convert RGBA bytes to the premultiplied texels of a pyramid."""
    image = pixels / np.float32(255)
    return np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], axis=-1)


def base(scene, index=0):
    offset, height, width = np.asarray(textures(scene).levels)[index, 0].tolist()
    return np.asarray(textures(scene).texels)[offset : offset + height * width].reshape(
        height, width, -1
    )


def test_textri_has_its_uv_and_texture(folder):
    scene = read(folder, textri("a.png") + '<rect width="5" height="5" fill="red"/>')
    assert np.asarray(scene.texture_index).tolist() == [0, -1, -1]
    assert np.asarray(scene.uv)[0].tolist() == [[0, 0], [1, 0], [0, 1]]
    assert scene.colors.shape == (3, 1, 4)
    assert scene.colors[:, 0].tolist() == [[1, 1, 1, 1], [1, 0, 0, 1], [1, 0, 0, 1]]
    assert (textures(scene).border, textures(scene).addressing) == ("clamp", "half_texel")
    np.testing.assert_array_equal(base(scene), premultiplied(PIXELS))


def test_course_textures_have_no_alpha_and_corner_addressing(folder):
    scene = read(folder, textri("a.png"), dialect="course", frame=False)
    assert textures(scene).addressing == "corners"
    assert scene.colors.shape == (1, 1, 3)  # alpha is dropped, not multiplied in
    np.testing.assert_array_equal(base(scene), PIXELS[..., :3] / np.float32(255))


def test_opaque_textures_have_no_alpha(folder):
    opaque = PIXELS.copy()
    opaque[..., 3] = 255
    (folder / "scenes" / "o.png").write_bytes(png_of(opaque))
    assert read(folder, textri("o.png")).colors.shape[-1] == 3
    assert base(read(folder, textri("o.png"))).shape[-1] == 3
    assert read(folder, textri("a.png"), opacity=False).colors.shape[-1] == 3


def test_only_used_textures_are_loaded_and_files_are_read_once(folder):
    body = (
        '<texture texid="x" filename="a.png"/><texture texid="y" filename="my pic.png"/>'
        '<texture texid="z" filename="./a.png"/>'
    )
    assert read(folder, body).textures is None
    use = '<textri points="0 0 9 0 0 9" uvs="0 0 1 0 0 1" texid="{}"/>'
    scene = read(folder, body + use.format("x") + use.format("z"))
    assert textures(scene).count == 1
    both = read(folder, body + use.format("y") + use.format("x"))
    assert textures(both).count == 2
    assert np.asarray(both.texture_index).tolist() == [0, 1]


def test_textures_in_defs_can_be_used(folder):
    scene = read(folder, "<defs>" + textri("a.png").split("<textri")[0] + "</defs><g>"
                 '<textri points="0 0 9 0 0 9" uvs="0 0 1 0 0 1" texid="t"/></g>')  # fmt: skip
    assert textures(scene).count == 1


def test_linear_textures_are_decoded_once(folder):
    scene = read(folder, textri("my pic.png"), linear=True)
    value = PIXELS[..., :3] / np.float32(255)
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(base(scene), light, rtol=1e-5, atol=1e-7)
    assert scene.colors.tolist() == [[[1, 1, 1]]]


def test_images_have_their_proportions(folder):
    """An image of 3 x 2 texels in a box of 30 x 40 px is drawn as 30 x 20 px in its middle."""
    image = '<image x="10" y="20" width="30" height="40" href="a.png" {}/>'
    scene = read(folder, image.format(""))
    assert corners_of(scene).reshape(-1, 2).min(axis=0).tolist() == [10, 30]
    assert corners_of(scene).reshape(-1, 2).max(axis=0).tolist() == [40, 50]
    # A translucent image is drawn as four triangles around an inner point, with matching uv.
    assert corners_of(scene).shape == (4, 3, 2)
    np.testing.assert_allclose(
        np.asarray(scene.uv), (corners_of(scene) - [10, 30]) / [30, 20], atol=1e-6
    )
    stretched = read(folder, image.format('preserveAspectRatio="none"'))
    assert corners_of(stretched).reshape(-1, 2).max(axis=0).tolist() == [40, 60]
    sliced = read(folder, image.format('preserveAspectRatio="xMaxYMid slice"'))
    assert corners_of(sliced).reshape(-1, 2).min(axis=0).tolist() == [10, 20]
    assert corners_of(sliced).reshape(-1, 2).max(axis=0).tolist() == [40, 60]
    np.testing.assert_allclose(np.asarray(sliced.uv)[..., 0].min(), 0.5, atol=1e-6)
    np.testing.assert_allclose(np.asarray(sliced.uv)[..., 1].max(), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("attributes", "size"),
    [("", (3, 2)), ('width="9"', (9, 6)), ('height="8"', (12, 8)), ('width="auto"', (3, 2))],
)
def test_missing_image_sizes_follow_the_file(folder, attributes, size):
    scene = read(folder, f'<image xlink:href="my%20pic.png" {attributes}/>')
    assert tuple(corners_of(scene).reshape(-1, 2).max(axis=0).tolist()) == size
    assert corners_of(scene).shape == (2, 3, 2)


@pytest.mark.parametrize(
    ("attributes", "half"),
    [("", 1.5), ('width="9"', 4.5), ('height="8"', 6), ('width="auto"', 1.5)],
)
def test_missing_image_sizes_count_in_bounding_boxes(folder, attributes, half):
    image = f'<image href="my%20pic.png" {attributes}/>'
    scene = read(folder, f'{BOX_CLIP.format(".5")}<g clip-path="url(#c)">{image}</g>')
    assert corners_of(scene)[..., 0].max() == half


def test_unreadable_images_without_size_do_not_count_in_bounding_boxes(folder):
    shapes = '<image href="no.png"/><rect width="9" height="9"/>'
    body = f'{BOX_CLIP.format("1")}<g clip-path="url(#c)">{shapes}</g>'
    with pytest.warns(UserWarning, match="not drawn: href of <image>"):
        assert corners_of(read(folder, body)).max() == 9


def test_hidden_and_empty_images_draw_nothing(folder):
    for attributes in ('width="0"', 'visibility="hidden"', 'display="none"'):
        scene = read(folder, f'<image href="a.png" {attributes}/>')
        assert scene.triangles.size == 0
    with pytest.warns(UserWarning, match="height of <image>.*negative"):
        scene = read(folder, '<image href="a.png" height="-3"/>')
    assert scene.triangles.size == 0
    with pytest.warns(UserWarning, match="image without href"):
        read(folder, "<image/>")


@pytest.mark.parametrize("attributes", ['width="0"', 'width="9" clip-path="url(#away)"'])
def test_images_without_area_leave_other_shapes(folder, attributes):
    body = (
        '<clipPath id="away"><rect x="50" y="50" width="2" height="2"/></clipPath>'
        f'<rect width="20" height="20"/><image {attributes} height="9" href="a.png"/>'
    )
    scene = read(folder, body)
    assert scene.triangles.shape[0] == 2 and scene.textures is None


def test_embedded_images_are_read():
    scene = parse_svg(f'<svg {NS} width="9" height="9"><image href="{embedded(PIXELS)}"/></svg>')
    np.testing.assert_array_equal(base(scene), premultiplied(PIXELS))
    spread = embedded(PIXELS).replace("base64,", "base64,\n  ").replace("+", "%2B")
    parse_svg(f'<svg {NS} width="9" height="9"><image href="{spread}"/></svg>')


def test_course_images_by_hand():
    """Images are drawn in whole pixels.

    Pixel x shows the texel at u (w - 1), for u = (x + 0.5 - p0) / (p1 - p0 + 1), where p0 and p1
    are the first and last pixel, and w the width of the image in texels.
    """
    pixels = np.zeros((1, 2, 3), np.uint8)
    pixels[0, 1] = 255
    text = (
        f'<svg {NS} width="9" height="9"><image x="2" y="1" width="3" height="0" '
        f'xlink:href="{embedded(pixels)}" transform="translate(0 1)"/></svg>'
    )
    scene = parse_svg(text, dialect="course", frame=False, transform=np.eye(3))
    quads = corners_of(scene).reshape(-1, 6, 2)
    assert quads.min(axis=1).tolist() == [[2, 2], [3, 2], [4, 2], [5, 2]]
    assert quads.max(axis=1).tolist() == [[3, 3], [4, 3], [5, 3], [6, 3]]
    np.testing.assert_allclose(np.asarray(scene.colors)[::2, 0, 0], [0.125, 0.375, 0.625, 0.875])
    mirrored = text.replace('width="3"', 'width="-3"')
    assert parse_svg(mirrored, dialect="course", frame=False).triangles.size == 0
    # Nothing is drawn off the canvas, and equal neighbouring pixels are one rectangle.
    black = text.replace(embedded(pixels), embedded(pixels * 0)).replace('x="2"', 'x="-2"')
    scene = parse_svg(black, dialect="course", frame=False, transform=np.eye(3))
    assert corners_of(scene).reshape(-1, 2).max(axis=0).tolist() == [2, 3]
    assert scene.triangles.shape[0] == 2


def test_course_images_beyond_float32_are_refused():
    image = (
        f'<image x="-1e38" width="2e38" height="4" xlink:href="{embedded(PIXELS)}" '
        'transform="scale(100000 100000)"/>'
    )
    text = f'<svg {NS} width="9" height="9">\n{image}</svg>'
    with pytest.raises(ValueError, match=r"^<svg>:2: <image> a coordinate is not finite"):
        parse_svg(text, dialect="course")


REFUSED = "outside|not a file beside|no such file|cannot be|is empty"


@pytest.mark.parametrize("dialect", ["svg", "course"])
@pytest.mark.parametrize(
    "name",
    ["../secret.png", "../img/map.png", "/etc/passwd", "link.png", "linked/map.png", "missing.png",
     "http://localhost:1/a.png", "file:///etc/passwd", "//localhost/a.png", "", ".",
     "ftp://x/a.png", "a.png/b", "x" * 5000, "..\\..", "loop.png", "\\\\host\\a.png"],
)  # fmt: skip
def test_files_elsewhere_are_refused(folder, name, dialect):
    (folder / "scenes" / "link.png").symlink_to(folder / "secret.png")
    (folder / "scenes" / "linked").symlink_to(folder / "img")
    (folder / "scenes" / "loop.png").symlink_to("loop.png")
    image = f'<image width="5" height="5" xlink:href="{name}"/>'
    for body in (textri(name), image):
        with pytest.raises(ValueError, match=REFUSED) as caught:
            read(folder, body, dialect=dialect, strict=True)
        assert "s.svg:2: <" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_images_that_cannot_be_read_are_left_out(folder):
    (folder / "scenes" / "bad.png").write_bytes(b"not a picture")
    rect = '<rect x="20" width="5" height="5"/>'
    for name in ("missing.png", "bad.png", "../secret.png", "data:image/png;base64,AAAA"):
        images = f'<image width="5" height="5" href="{name}"/>\n' * 2
        named = r"s\.svg: not drawn: href of <image> \(2 times, first in line 2: .*\)\.$"
        with pytest.warns(UserWarning, match=named):
            scene = read(folder, images + rect)
        assert scene.textures is None
        assert scene.triangles.shape == (2, 3)
        # Textured triangles belong to the course's dialect, and are refused as in it.
        with pytest.raises(ValueError, match=r"s\.svg:2: <text"):
            read(folder, textri(name))


def test_images_beyond_the_limit_are_refused(folder, monkeypatch):
    monkeypatch.setitem(budget._LIMITS, "texels", budget._Limit(5, "pixels of pictures"))
    with pytest.raises(ValueError, match=r"s\.svg:2: <image> .*at most 5"):
        read(folder, '<image href="a.png"/>')


def test_assets_opens_another_folder(folder):
    body = textri("../img/map.png")
    for assets in (folder, str(folder), folder / "scenes" / ".."):
        assert textures(read(folder, body, assets=assets)).count == 1
    with pytest.raises(ValueError, match="outside"):
        read(folder, body, assets=folder / "scenes")
    with pytest.raises(ValueError, match="outside"):
        read(folder, textri("a.png"), assets=folder / "img")


def test_texts_need_a_folder_for_files(folder):
    text = f'<svg {NS} width="9" height="9">\n{textri("a.png")}</svg>'
    with pytest.raises(ValueError, match=r"<svg>:2: .*assets"):
        parse_svg(text)
    assert textures(parse_svg(text, assets=folder / "scenes")).count == 1


@pytest.mark.parametrize(
    ("href", "match"),
    [
        ("data:image/png;base64,@@@@", "base64"),
        ("data:image/png;base64,AAAA", "image"),
        ("data:image/png,abc", "base64"),
        ("data:text/html;base64,AAAA", "base64 images"),
        ("data:image/svg+xml;base64,AAAA", "SVG inside"),
        ("data:", "base64"),
    ],
)
@pytest.mark.parametrize("dialect", ["svg", "course"])
def test_invalid_data_uris_are_refused(href, match, dialect):
    image = f'<image width="5" height="5" xlink:href="{href}"/>'
    text = f'<svg {NS} width="9" height="9">\n\n{image}</svg>'
    with pytest.raises(ValueError, match=rf"<svg>:3: <image> .*{match}") as caught:
        parse_svg(text, dialect=dialect, strict=True)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_image_are_named(folder):
    (folder / "scenes" / "bad.png").write_bytes(b"not a picture")
    with pytest.raises(ValueError, match=r"s\.svg:2: <textri> .*bad\.png"):
        read(folder, textri("bad.png"))
