"""Hostile, broken and too large XML is refused in one line, with the line number."""

import gzip

import numpy as np
import pytest

from softras2d.io.svg.reading.reader import parse_svg, read_svg, svg_size

from ....cases.work import count_calls

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10">'
RECT = '<rect width="5" height="5"/>'


def assert_refused(text, match, **options):
    with pytest.raises(ValueError, match=match) as caught:
        parse_svg(text, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_nested_entities_are_refused():
    entities = "".join(
        f'<!ENTITY l{i} "{"&l" + str(i - 1) + ";" if i else "lol"}">\n' * 1 for i in range(9)
    )
    # The first entity refers to nothing. The second, on the next line, refers to the first.
    assert_refused(f"<!DOCTYPE svg [\n{entities}]>{HEAD}&l8;</svg>", ":3: .*entity")
    for dialect in ("svg", "course"):
        assert_refused(f"<!DOCTYPE svg [\n{entities}]>{HEAD}&l8;</svg>", "entity", dialect=dialect)


@pytest.mark.parametrize(
    "declaration",
    ['<!ENTITY x SYSTEM "file:///etc/passwd">', '<!ENTITY % x SYSTEM "http://localhost:1/x">%x;',
     '<!ENTITY x SYSTEM "a.gif" NDATA gif>', '<!ENTITY x "&#38;y;">', '<!ENTITY x "<rect/>">',
     f'<!ENTITY x "{"1" * 1000}">', "".join(f'<!ENTITY x{i} "1">' for i in range(1000))],
)  # fmt: skip
def test_entities_are_refused(declaration):
    assert_refused(f"<!DOCTYPE svg [{declaration}]>\n{HEAD}</svg>", "<svg>:1: .*entity")


def test_short_texts_are_read_as_entities_outside_of_the_course():
    """Drawing programs declare such entities for namespaces."""
    text = f'<!DOCTYPE svg [<!ENTITY x "5">]>{HEAD}<rect width="&x;" height="5"/></svg>'
    assert float(np.asarray(parse_svg(text).positions).max()) == 5
    assert_refused(text, "<svg>:1: .*entity", dialect="course")


def test_undeclared_entities_are_refused():
    assert_refused(f"{HEAD}\n&boo;</svg>", ":2: .*undefined entity")
    doctype = '<!DOCTYPE svg SYSTEM "http://localhost:1/svg.dtd">'
    assert_refused(f"{doctype}{HEAD}\n&boo;</svg>", ":2: .*entity")


def test_doctype_comments_and_instructions_are_skipped():
    doctype = (
        '<?xml version="1.0" encoding="utf-8" standalone="no"?>\n<!-- a -->'
        '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" '
        '"http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd" [<!-- inside -->]>\n<?php no ?>'
    )
    scene = parse_svg(doctype + HEAD + "<!-- b --><?x y?>text" + RECT + "</svg>")
    assert scene.triangles.shape[0] == 2


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1", "us-ascii", "cp1252"])
def test_encodings_are_read(encoding):
    text = f'<?xml version="1.0" encoding="{encoding}"?>{HEAD}{RECT}</svg>'
    assert parse_svg(text.encode(encoding)).triangles.shape[0] == 2


@pytest.mark.parametrize("encoding", ["utf-16", "iso-8859-1", "klingon"])
def test_a_string_is_read_whatever_encoding_it_declares(encoding):
    text = f'<?xml version="1.0" encoding="{encoding}"?>{HEAD}<é/>{RECT}</svg>'
    with pytest.warns(UserWarning, match="é"):
        assert parse_svg(text).triangles.shape[0] == 2


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", ":1: not well-formed"),
        ("hello", ":1: not well-formed"),
        (f"{HEAD}\n\n<rect", ":3: not well-formed"),
        (f"{HEAD}\n<g></svg>", ":2: not well-formed.*mismatched"),
        (f"{HEAD}</svg>\n{HEAD}</svg>", ":2: not well-formed"),
        (f'{HEAD}\n<rect x="1" x="2"/></svg>', ":2: not well-formed.*duplicate"),
        ("<html/>", ":1: <html> .*root"),
        (b'<?xml version="1.0" encoding="klingon"?><svg/>', ":1: .*encoding"),
        (b'<?xml version="1.0" encoding="big5"?><svg/>', ":1: .*(encoding|decoded)"),
        (f"{HEAD}\n\ud800</svg>", ":2: not well-formed"),
        (b'<svg width="1" height="1">\n\xff\xfe</svg>', ":2: not well-formed"),
        (b"\0\0\0", ":1: not well-formed"),
        (gzip.compress(b"<svg/>" * 50, mtime=0)[:-9], "decompressed: it is cut short"),
        (b"\x1f\x8bnonsense", "cannot be decompressed"),
        (gzip.compress(b"<svg", mtime=0), ":1: not well-formed"),
        (gzip.compress(bytes(65 * 2**20), mtime=0), "larger than 64 MB when decompressed"),
    ],
)
@pytest.mark.parametrize("dialect", ["svg", "course"])
def test_malformed_files_are_refused(text, match, dialect):
    assert_refused(text, match, dialect=dialect, height=5, width=5)


def test_nesting_is_limited():
    for opening in ("<g>", '<g opacity="1" transform="scale(1)">', "<circle>", "<text>", "<defs>"):
        count = 2_000
        name = opening.strip("<>").split()[0]
        text = HEAD + opening * count + RECT + f"</{name}>" * count + "</svg>"
        if name == "text":
            with pytest.warns(UserWarning, match="text"):
                parse_svg(text)
        else:
            assert parse_svg(text).triangles.shape[0] == (2 if name == "g" else 0)
    assert_refused(HEAD + "\n" + "<g>" * 200_000, ":2: <g> .*deeper")


def test_large_files_are_refused(tmp_path):
    path = tmp_path / "large.svg"
    with path.open("wb") as file:
        file.write(HEAD.encode())
        file.truncate(100 * 2**20)
    with pytest.raises(ValueError, match=r"large\.svg: larger than 64 MB"):
        read_svg(path)


def test_endless_files_are_refused():
    with pytest.raises(ValueError, match="larger than 64 MB"):
        read_svg("/dev/zero")


def test_missing_files_are_refused(tmp_path):
    for path in (tmp_path / "no.svg", tmp_path, "a\0b"):
        with pytest.raises(ValueError, match=r"cannot be read|null") as caught:
            read_svg(path)
        assert "\n" not in str(caught.value)


def test_compressed_files_are_read(tmp_path):
    path = tmp_path / "a.svgz"
    path.write_bytes(gzip.compress(f"{HEAD}{RECT}</svg>".encode()))
    assert read_svg(path).triangles.shape[0] == 2
    assert svg_size(path) == (10, 10)


@pytest.mark.parametrize("dialect", ["svg", "course"])
@pytest.mark.parametrize(
    "element",
    [
        '<rect x="nan" width="1" height="1"/>',
        '<rect x="" width="1" height="1"/>',
        '<rect x="1e999" width="1" height="1"/>',
        '<line x1="inf" stroke="#f00"/>',
        '<polygon points="1,2 3,nan 5,6"/>',
        '<polyline points="1,2 inf,4 5,6" stroke="#f00"/>',
        '<polygon points="0,0 1,0 1,1" transform="rotate(1"/>',
        '<g transform="matrix(1 2 3)"/>',
        '<g transform="translate(nan 0)"/>',
        '<colortri points="0 0 1 0 1" colors="1 1 1 1 1 1 1 1 1 1 1 1"/>',
        '<colortri points="0 0 1 0 1 1" colors="1 1 1 1"/>',
        '<colortri points="0 0 1 0 1 1" colors="1 1 1 1 1 1 1 1 1 1 1 nan"/>',
        '<textri points="0 0 1 0 1 1" uvs="0 0 1 0 1 1" texid="nope"/>',
        '<rect x="3e38" y="3e38" width="3e38" height="3e38" stroke="#000"/>',
        '<polygon points="0,0 1e39,0 1,1"/>',
        '<rect width="1" height="1" fill-opacity="x"/>',
    ],
)
def test_bad_values_name_line_and_element(element, dialect):
    name = element[1:].split()[0]
    text = f"{HEAD}\n\n{element}\n</svg>"
    message = assert_refused(text, r"<svg>:3: ", dialect=dialect, strict=True)
    assert f"<{name}>" in message or "finite" in message


@pytest.mark.parametrize(
    ("element", "attribute"),
    [
        ('<rect x="nan" width="1" height="1"/>', "x"),
        ('<rect x="44mmx" width="1" height="1"/>', "x"),
        ('<line x1="inf" stroke="#f00"/>', "x1"),
        ('<polygon points="1,2 3,nan 5,6"/>', "points"),
        ('<polygon points="1,2 3,4 5,6,"/>', "points"),
        ('<polygon points="0,0 1,0 1,1" transform="rotate(30 5)"/>', "transform"),
        ('<g transform="matrix(1 2 3)"/>', "transform"),
        ('<path d="M 1 2 L 3 x"/>', "d"),
        ('<rect width="1" height="1" fill-opacity="x"/>', "fill-opacity"),
        ('<rect width="1" height="1" style="fill:nothing"/>', "fill"),
    ],
)
def test_bad_attributes_do_not_hide_the_rest(element, attribute):
    """One warning names the attribute, the element and the line, and everything else is drawn."""
    name = element[1:].split()[0]
    rest = '<rect x="2" y="3" width="4" height="5" fill="red"/>'
    with pytest.warns(UserWarning) as caught:
        scene = parse_svg(f"{HEAD}\n\n{element}{element}\n{rest}</svg>")
    assert len(caught) == 1
    warning = str(caught[0].message)
    assert f"{attribute} of <{name}> (2 times, first in line 3" in warning
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)][-2:]
    assert corners.min(axis=(0, 1)).tolist() == [2, 3]
    assert corners.max(axis=(0, 1)).tolist() == [6, 8]


def test_numbers_beyond_float32_are_refused_when_drawn():
    assert_refused(f'{HEAD}\n<g transform="scale(1e300)">{RECT}</g></svg>', r":2: .*finite")
    wide = '<rect width="1e300" height="1" transform="scale(1e300)"/>'
    assert_refused(f"{HEAD}\n{wide}</svg>", ":2: ")
    for stroke in ('stroke="red"', 'stroke="red" stroke-opacity=".5"'):
        element = f'<line x2="1e39" {stroke} transform="scale(1e200)"/>'
        assert_refused(f"{HEAD}\n{element}</svg>", r":2: .*finite")


def test_too_many_crossings_are_refused():
    points = " ".join(map(str, np.random.default_rng(0).random(6000).round(4)))
    assert_refused(
        f'{HEAD}\n<polygon points="{points}"/></svg>', ":2: .*cross themselves; at most 100,000"
    )


def test_sizes_are_read_or_refused(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text('<svg width="210mm" height="99.5"><broken')
    assert svg_size(path) == (100, 794)
    assert svg_size(str(path), dialect="course") == (100, 210)
    path.write_text('<svg viewBox="0 0 30.5 20"/>')
    assert svg_size(path) == (20, 31)
    sheet = "<style>svg { width: 40px } @media (width: 8px) { svg { height: 7px } }</style>"
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="8" height="9" style="height: 6px">'
    path.write_text(f"{head}{sheet}</svg>")
    assert svg_size(path) == (6, 40)
    path.write_text(path.read_text().replace("height: 7px", "height: 7px !important"))
    assert svg_size(path) == (7, 40)
    for text in ("<svg/>", '<svg width="100%" height="3"/>', '<svg width="3"/>'):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"a\.svg: <svg> gives no size"):
            svg_size(path)
        with pytest.raises(ValueError, match="gives no size"):
            read_svg(path)
    for text in ('<svg width="-1" height="3"/>', '<svg viewBox="0 0 0 1"/>', '<svg width="2em"/>'):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"a\.svg: <svg>"):
            svg_size(path)


@pytest.mark.parametrize(
    "options",
    [
        {"height": 0},
        {"width": -3},
        {"width": 10**9},
        {"dialect": "pdf"},
        {"frame": True},
        {"transform": np.zeros((3, 3))},
        {"transform": np.eye(2)},
        {"transform": np.full((3, 3), np.nan)},
        {"transform": -np.eye(3)},
        {"transform": [[1, 0, 0], [0, 1, 0], [-1, 0, 1]]},
    ],
)
def test_invalid_options_are_refused(options):
    text = f"{HEAD}{RECT}</svg>"
    with pytest.raises(ValueError, match=r"height|width|dialect|frame|transform"):
        parse_svg(text, **options)


def test_strokes_behind_a_projection_are_refused():
    text = f'{HEAD}\n<line x2="9" y2="9" stroke="red"/></svg>'
    with pytest.raises(ValueError, match=r":2: .*w <= 0"):
        parse_svg(text, transform=[[1, 0, 0], [0, 1, 0], [-1, 0, 1]])


def polygons(count: int) -> tuple[str, np.ndarray]:
    """A drawing of `count` triangles in different colours, and their corners."""
    rng = np.random.default_rng(0)
    corners = (rng.random((count, 1, 2)) * 1000 + rng.random((count, 3, 2)) * 20).round(2)
    colors = (rng.random((count, 3)) * 100).round(4)
    lines = [
        '<polygon points="{},{} {},{} {},{}" fill="rgb({}% {}% {}%)"/>'.format(*row)
        for row in np.concatenate([corners.reshape(-1, 6), colors], axis=1).tolist()
    ]
    return '<svg width="1000" height="1000">' + "\n".join(lines) + "</svg>", corners


def test_five_thousand_polygons_are_read_exactly():
    text, corners = polygons(5_000)
    np.testing.assert_array_equal(
        np.asarray(parse_svg(text).positions).reshape(-1, 3, 2), corners.astype(np.float32)
    )


def test_work_is_linear_in_the_number_of_polygons():
    few, many = (count_calls(lambda n=n: parse_svg(polygons(n)[0])) for n in (200, 2_000))
    assert many < 12 * few
