"""Small files that would take hours are read, or refused in one line, within seconds.

What takes quadratic time or worse would take hours here; an alarm ends such a test.
"""

import base64
import contextlib
import os
import signal
import warnings
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.io.budget import MAX_TEXELS, Budget, BudgetError
from softras2d.io.images import decode_image, read_image
from softras2d.io.svg import (
    assets,
    cascade,
    css_color,
    css_transform,
    media_queries,
    notices,
    numbers,
    path_data,
    style,
    transform_attribute,
    tree,
    units,
    view_box,
)
from softras2d.io.svg.font_size import shorthand_size
from softras2d.io.svg.reader import parse_svg, read_svg
from softras2d.io.svg.transform_origin import transform_origin

from ..cases.marks import slowly
from ..cases.png_files import png

LENGTH = 50_000

DATA = os.environ.get("SOFTRAS2D_DATA", "")


@contextlib.contextmanager
def ends_within(seconds: int) -> Iterator[None]:
    """Raise `TimeoutError` in what takes more processor time.

    The limit is loose, as it is no measurement.
    """

    def stop(*_: object) -> None:
        raise TimeoutError(f"not done in {seconds} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def outcome(text, dialect="svg", **options):
    """The scene, or the error's message, which is one line that begins with name and line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            return parse_svg(text, dialect=dialect, height=60, width=80, **options)
        except ValueError as error:
            message = str(error)
    assert message.startswith("<svg>:1: ") and "\n" not in message
    return message


def runs(*characters):
    return "".join(character * (LENGTH // len(characters)) for character in characters)


ADVERSARIAL = {
    "digits": runs("1"),
    "digits, then a mark": runs("1") + "!",
    "blanks": runs(" ") + "!",
    "digits, blanks": runs("1", " ") + "!",
    "digits and blanks": "1 " * (LENGTH // 2) + "!",
    "digits, blanks, digits, blanks": runs("1", " ", "1", " ") + "!",
    "point, digits": "1." + runs("1") + "!",
    "commas": runs(","),
    "commas and blanks": "1 , " * (LENGTH // 4) + ", ,",
    "signs": runs("+"),
    "signed digits": "-1" * (LENGTH // 2) + "!",
    "exponents": "1" + runs("e"),
    "numbers with exponents": "1e" * (LENGTH // 2),
    "opening": runs("("),
    "opening and closing": runs("(", ")"),
    "functions": "a(" * (LENGTH // 2),
    "letters, blanks": runs("a", " ") + "!",
    "an url without end": "url(" + runs("a"),
    "an url of quotes": "url(" + "\"a\"'b'" * (LENGTH // 6),
    "an url of one quote": "url(" + runs('"', "a") + "!",
    "hex": "#" + runs("f"),
    "percentages": "rgb(" + runs("1", "%", " "),
    "words": "nan" * (LENGTH // 3),
    "semicolons": "a:b;" * (LENGTH // 4),
    "parameters": "data:image/png" + ";a" * (LENGTH // 2),
    "comments": "/*" * (LENGTH // 2),
    "strings": "'" + runs("\\"),
}


VIEWPORT = units.Viewport(1.0, 1.0, 1.0, 1.0)
UNITS = css_transform.Units(VIEWPORT, view_box.Box(0.0, 0.0, 1.0, 1.0), 16.0)


def declarations(attributes):
    page_notices = notices.Notices("a.svg", False)
    return cascade.Cascade(page_notices, Budget(), 9, 9).declarations(
        tree.Element("rect", "rect", attributes, None, 1)
    )


def document_size(attributes):
    return view_box.document_size(declarations(attributes), 16.0, lambda *_: None)


def style_sheet(text):
    element = tree.Element("style", "style", {}, None, 1)
    element.texts = [text]
    cascade.Cascade(notices.Notices("a.svg", False), Budget(), 9, 9).add_sheet(element)


PARSERS = {
    "number_list": numbers.number_list,
    "number_pairs": numbers.number_pairs,
    "blank_separated": numbers.blank_separated,
    "leading_float": numbers.leading_float,
    "length": lambda text: numbers.length(text, 1.0),
    "fraction": numbers.fraction,
    "transform": transform_attribute.transform_list,
    "course transform": lambda text: transform_attribute.course_transform(text, lambda name: None),
    "color": css_color.color_of,
    "paint": style._paint,
    "style": lambda text: declarations({"style": text}),
    "style sheet": style_sheet,
    "leading numbers": numbers.leading_numbers,
    "path data": path_data.parse_path_data,
    "arcs": lambda text: path_data.parse_path_data(f"M0 0a{text}"),
    "CSS transform": lambda text: css_transform.transform_property(text, UNITS),
    "CSS translate": lambda text: css_transform.translate_property(text, UNITS),
    "CSS rotate": lambda text: css_transform.rotate_property(text, UNITS),
    "media query": lambda text: media_queries.matches(text, 9, 9),
    "media feature": lambda text: media_queries.matches(f"(width < {text})", 9, 9),
    "background": style._background,
    "origin": lambda text: transform_origin(text, (0.0, 0.0, 1.0, 1.0), VIEWPORT, 16.0),
    "font": lambda text: shorthand_size(text, 16.0, VIEWPORT),
    "dashes": lambda text: style._dasharray(text, style.INITIAL, VIEWPORT, 16.0),
    "url": style.reference_of,
    "view_box": lambda text: view_box.view_box({"viewBox": text}),
    "aspect": lambda text: view_box.fit(view_box.Box(0.0, 0.0, 1.0, 1.0), 1.0, 1.0, text),
    "width": lambda text: document_size({"width": text, "height": "1"}),
    "CSS width": lambda text: document_size({"style": f"width: {text}", "height": "1"}),
    "data": assets._embedded,
    "file": lambda text: assets.Assets(Path(), Path(), alpha=True).declare("0", text),
}


@pytest.mark.parametrize("text", ADVERSARIAL.values(), ids=ADVERSARIAL)
def test_every_parser_takes_linear_time(text):
    for name, read in PARSERS.items():
        with ends_within(5), contextlib.suppress(ValueError):
            read(text)
            assert name


ATTRIBUTES = (
    '<rect x="{}" width="1" height="1"/>',
    '<rect width="1" height="1" opacity="{}"/>',
    '<rect width="1" height="1" fill-opacity="{}" stroke="red" stroke-width="{}"/>',
    '<rect width="1" height="1" fill="{}"/>',
    '<rect width="1" height="1" style="fill:{}"/>',
    '<polygon points="1 2 {}"/>',
    '<g transform="{}"><rect width="1" height="1"/></g>',
    '<image width="1" height="1" href="{}"/>',
    '<textri points="0 0 1 0 0 1" uvs="{}" texid="a"/>',
    '<path d="M0 0 L{}"/>',
    '<path stroke="red" stroke-dasharray="{}" d="M0 0h9"/>',
    "<style>{} { fill: {} }</style><rect/>",
    '<rect width="1" height="1" clip-path="{}" transform-origin="{}" transform="scale(2)"/>',
)


@pytest.mark.parametrize("dialect", ["svg", "course"])
@pytest.mark.parametrize("element", ATTRIBUTES)
def test_every_attribute_takes_linear_time(element, dialect):
    for text in ADVERSARIAL.values():
        escaped = text.replace('"', "&quot;")
        with ends_within(5):
            body = element.replace("{}", escaped.replace("<", "&lt;"))
            outcome(f'<svg width="9" height="9">{body}</svg>', dialect)
            outcome(f'<svg width="{escaped}" height="9"/>', dialect)


@pytest.mark.parametrize("pattern", ["lab", "lch", "oklab", "oklch", "rgb", "hsl", "hwb"])
def test_colours_of_any_size_are_finite(pattern):
    """Shapes in such colours are drawn in finite ones."""
    values = ("1e308", "-1e308", "1e155", "1e999", "-1e999", "none", "50%", "1e308%", "9" * 400)
    for first in values:
        for second in values:
            text = f"{pattern}({first} {second} {second})"
            scene = outcome(f'<svg><rect fill="{text}" width="5" height="5"/></svg>')
            assert not isinstance(scene, str), scene
            assert np.isfinite(np.asarray(scene.colors)).all()


@pytest.mark.parametrize("brackets", ["(", "[", "{", "f(", "()", "([{"])
@pytest.mark.parametrize("count", [30, 1000, 100_000])
def test_deeply_nested_brackets_end(brackets, count):
    for attribute in ("style", "fill"):
        prefix = "fill:" if attribute == "style" else ""
        text = f'<svg><rect {attribute}="{prefix}{brackets * count}" width="1" height="1"/></svg>'
        nested = count * len(brackets.strip("f")) > 32 and brackets != "()"
        with ends_within(15):
            assert not isinstance(outcome(text), str)
            message = outcome(text, strict=True)
        assert isinstance(message, str)
        assert ("nested deeper than 32" in message) == (attribute == "style" and nested)


def test_many_attribute_defaults_are_refused():
    declared = " ".join(f'a{i} CDATA "x"' for i in range(10_000))
    text = f"<!DOCTYPE svg [<!ATTLIST g {declared}>]><svg>{'<g/>' * 10_000}</svg>"
    with ends_within(15):
        assert "more than 256 attribute defaults" in str(outcome(text))


def points(array):
    return " ".join(f"{x:.5g},{y:.5g}" for x, y in np.asarray(array).tolist())


def polygon(array, attributes=""):
    return f'<polygon points="{points(array)}" {attributes}/>'


def wave(count):
    across = np.linspace(0, 10, count)
    upper = np.stack([across, 5 + 4 * np.sin(40 * across)], axis=1)
    lower = np.stack([across[::-1], np.full(count, 5.1)], axis=1)
    return np.concatenate([upper, lower])


def spiral(count):
    angle = np.linspace(0, 100 * np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) / 80
    return np.concatenate([along * (angle + 1)[:, None], (along * (angle + 4)[:, None])[::-1]])


def random(count, seed=0):
    return np.random.default_rng(seed).random((count, 2)) * 10


BLACK = 'fill="black"'
TRANSLUCENT = 'fill-opacity=".5"'
STROKE = 'fill="none" stroke="red" stroke-linejoin="round" stroke-linecap="round"'

# The drawing, and in the dialect `svg` the number of triangles or what the error must name.
SHAPES = {
    "equal points": (polygon(np.ones((20_000, 2))), 0),
    "one segment, to and fro": (polygon(np.tile([[1, 1], [9, 9]], (10_000, 1))), 0),
    "a square, again and again": (
        polygon(np.tile([[1, 1], [9, 1], [9, 9], [1, 9]], (5_000, 1))), 2,
    ),
    "a wave and a line": (polygon(wave(20_000)), None),
    "a spiral": (polygon(spiral(20_000)), None),
    "a spiral of glass": (polygon(spiral(10_000), TRANSLUCENT), None),
    "tangles": ("".join(polygon(random(440, seed)) for seed in range(30)), "cross themselves"),
    "small tangles": ("".join(polygon(random(60, i)) for i in range(300)), "cross themselves"),
    "a long tangle": (polygon(random(100_000)), "cross"),
    "huge joins": (
        f'<polyline points="{points(random(20_000))}" {STROKE} transform="scale(1e15)"/>',
        "2,097,152",
    ),
    "a stroke of glass": (
        f'<polyline points="{points(random(20_000))}" {STROKE} stroke-opacity=".5"/>',
        "pairs of edges",
    ),
    "zigzag": (polygon([[i % 2 * 9, i / 2000] for i in range(15_000)]), None),
}  # fmt: skip


@pytest.mark.parametrize("dialect", ["svg", "course"])
@pytest.mark.parametrize("name", SHAPES)
def test_costly_shapes_are_read_or_refused_in_time(name, dialect):
    body, expected = SHAPES[name]
    with ends_within(20):
        result = outcome(f'<svg width="10" height="10">{body}</svg>', dialect, frame=False)
    if dialect == "course":
        return
    if isinstance(expected, str):
        assert isinstance(result, str) and expected in result
        assert "at most" in result
    else:
        assert not isinstance(result, str), result
        assert expected is None or result.triangles.shape[0] == expected


def low_poly(count: int) -> str:
    """Triangles as low-poly generators write them: one path for each, with a colour."""
    corners = random(3 * count).reshape(-1, 6).tolist()
    d = "M{:.3f},{:.3f}L{:.3f},{:.3f}L{:.3f},{:.3f}Z"
    fill = '<path d="{}" fill="rgb({},{},{})"/>'
    return "".join(
        fill.format(d.format(*points), k % 256, k // 256, 7) for k, points in enumerate(corners)
    )


def many_paths(count: int) -> str:
    """Paths of 100 points each, around circles."""
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path = '<path d="M{}Z" fill="#{:06x}"/>'
    return "".join(
        path.format("L".join(map("{:.2f},{:.2f}".format, *(center + 3 * circle).T)), k)
        for k, center in enumerate(random(count))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "triangles"),
    [
        pytest.param(low_poly(5078), 5078, id="5,078 paths of one triangle"),
        pytest.param(many_paths(1000), 98_000, id="1e5 points"),
    ],
)
def test_large_drawings_are_read_in_time_without_a_warning(body, triangles):
    """`experiments/svg_files` measures the time, which checks of types multiply here."""
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10">{body}</svg>'
    with ends_within(30), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert parse_svg(text).triangles.shape[0] == triangles


@pytest.mark.slow
def test_an_opaque_stroke_of_many_dashes_in_a_group_is_cut_out_in_time():
    """What it hides is removed from both rectangles, and nothing else."""
    drawing = (
        '<svg><g opacity="0.5"><rect width="9000" height="40"/><rect width="9000" height="40"/>'
        '<path d="M0 20H120000" stroke="red" stroke-dasharray="3 1" stroke-width="2"/></g></svg>'
    )
    with ends_within(20):
        scene = outcome(drawing)
    assert area(scene) == pytest.approx(9000 * 40 + 111_000 / 4 * 3 * 2, rel=1e-3)


def area(scene):
    positions = np.asarray(scene.positions, np.float64)
    a, b, c = np.moveaxis(positions[np.asarray(scene.triangles)], 1, 0)
    return np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2


@pytest.mark.parametrize("style", [BLACK, TRANSLUCENT])
def test_large_polygons_have_their_area(style):
    """The area of the triangles equals that by the shoelace formula, for a spiral."""
    outline = spiral(1500) * 8 + 40
    x, y = outline.T
    expected = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    scene = parse_svg(f'<svg width="80" height="80">{polygon(outline, style)}</svg>')
    assert area(scene) == pytest.approx(expected, rel=1e-3)


def test_fill_rules_of_a_large_polygon():
    """The inner turn of a ring of two turns is a hole under the even-odd rule alone."""
    angle = np.linspace(0, 4 * np.pi, 400, endpoint=False)
    radius = np.where(angle < 6.2831, 4, 2)[:, None]
    ring = 5 + np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius
    filled, hole = (
        area(parse_svg(f'<svg width="10" height="10">{polygon(ring, rule)}</svg>'))
        for rule in ('fill-rule="nonzero"', 'fill-rule="evenodd"')
    )
    assert filled == pytest.approx(np.pi * 16, rel=0.01)
    assert hole == pytest.approx(np.pi * 12, rel=0.01)


def grey_png(height, width, rows=b""):
    """A grey PNG of one bit per pixel."""
    rows = rows or bytes((width // 8 + 1) * height)
    return png(height, width, zlib.compress(rows, 9), bits=1, channels=1)


def test_an_image_that_would_fill_the_memory_is_refused(tmp_path):
    data = grey_png(16384, 16384, b"short")
    (tmp_path / "bomb.png").write_bytes(data)
    for read in (
        lambda: read_image(tmp_path / "bomb.png"),
        lambda: decode_image(data, "bomb.png"),
    ):
        with ends_within(15), pytest.raises(ValueError, match=r"bomb\.png: 16384 x 16384 .* 1\.$"):
            read()
    uri = "data:image/png;base64," + base64.b64encode(data).decode()
    message = outcome(f'<svg><image width="9" height="9" href="{uri}"/></svg>')
    assert "<image> embedded image: 16384 x 16384 pixels" in str(message)


def test_images_of_a_document_share_a_limit(tmp_path):
    (tmp_path / "first.png").write_bytes(grey_png(1024, 4096))
    # The second is damaged, and must be refused before it is decoded.
    (tmp_path / "second.png").write_bytes(grey_png(1024, 4096, b"damaged"))
    budget = Budget()
    budget.charge("texels", MAX_TEXELS - 2**22)
    pictures = assets.Assets(tmp_path, None, True, budget)
    assert pictures.picture("first.png").shape == (1024, 4096, 3)
    with pytest.raises(BudgetError, match="pixels of pictures; at most 67,108,864"):
        pictures.picture("second.png")


def test_a_course_image_is_refused_before_it_becomes_triangles(tmp_path):
    noise = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    sr.write_image(tmp_path / "noise.png", noise)
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg width="4096" height="4096"><image width="4096" height="4096" href="noise.png"/></svg>'
    )
    with ends_within(30), pytest.raises(ValueError, match=r"a\.svg:1: <image> .*2,097,152"):
        read_svg(path, dialect="course", height=4096, width=4096)


def drawing(attribute):
    return f'<svg width="9" height="9"><rect {attribute} width="5" height="5"/></svg>'


MADE_HERE = {
    "polygon.svg": f'<svg width="9" height="9">{polygon(np.ones((20_000, 2)))}</svg>',
    "colour.svg": drawing('fill="lab(1e308 1e308 1e308)"'),
    "length.svg": drawing(f'x="{"1" * 5000}{" " * 5000}!"'),
    "style.svg": drawing(f'style="fill:{"(" * 1000}"'),
    "bomb.png": grey_png(16384, 16384),
}


@pytest.fixture(scope="module", params=["own", slowly("data")])
def folder(request, tmp_path_factory):
    """Files made here, and those of the folder `hostile` in SOFTRAS2D_DATA."""
    if request.param == "data":
        if not DATA:
            pytest.skip("SOFTRAS2D_DATA is not set")
        return Path(DATA) / "hostile"
    folder = tmp_path_factory.mktemp("hostile")
    for name, content in MADE_HERE.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def test_every_hostile_file_is_read_or_refused_in_one_line(folder):
    for path in sorted(folder.iterdir()):
        if path.suffix == ".svg":
            reads = [
                partial(read_svg, path, dialect=dialect, height=60, width=80)
                for dialect in ("svg", "course")
            ]
        elif path.suffix in (".png", ".exr"):
            reads = [partial(read_image, path)]
        else:
            continue
        for read in reads:
            with ends_within(30), warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                try:
                    read()
                except ValueError as error:
                    assert "\n" not in str(error)


def test_bundled_scenes_are_far_from_the_limits():
    for name in scenes.names():
        if not scenes.is_scripted(name):
            assert scenes.read(name).triangles.shape[0] < 2**17
