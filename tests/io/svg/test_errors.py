"""Errors and warnings about drawings are one line, with the file and the line of the element."""

import warnings

import numpy as np
import pytest

from softras2d.io.images import write_image
from softras2d.io.svg.reading.reader import parse_svg

HUGE = "1e39"
"""A number that is finite in float64, but not in float32."""


def drawing(*elements: str, size: int = 100) -> str:
    body = "\n".join(elements)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="{size}">\n{body}\n</svg>'
    )


COLORS = {
    "fill": f'<rect fill="color(srgb {HUGE} 0 0)" width="5" height="5"/>',
    "background": f'<rect fill="color(srgb 0 {HUGE} 0)" width="100" height="100"/>',
    "stroke": f'<line stroke="color(srgb 0 0 -{HUGE})" x2="9" y2="9"/>',
    "polygon": f'<polygon points="0 0 9 0 9 9 0 5" fill="color(srgb {HUGE} 0 0)"/>',
    "corners": f'<colortri points="0 0 9 0 0 9" colors="0 0 0 1 {HUGE} 0 0 1 0 0 0 1"/>',
}


@pytest.mark.parametrize("element", COLORS.values(), ids=COLORS)
def test_a_color_beyond_float32_is_named_with_its_line(element):
    with pytest.raises(ValueError, match=r"^a\.svg:3: a colour is not finite in float32\.$"):
        parse_svg(drawing("<g/>", element, '<rect width="1" height="1"/>'), name="a.svg")


def test_texture_coordinates_beyond_float32_are_named_with_their_line(tmp_path):

    write_image(tmp_path / "t.png", np.ones((2, 2, 3), np.float32))
    text = drawing(
        '<texture texid="t" filename="t.png"/>',
        f'<textri points="0 0 9 0 0 9" uvs="0 0 {HUGE} 0 0 1" texid="t"/>',
    )
    for dialect in ("svg", "course"):
        with pytest.raises(ValueError, match=r"^a\.svg:3: .*not (a )?finite"):
            parse_svg(text, name="a.svg", dialect=dialect, assets=tmp_path)


def messages_of(text, dialect, assets):
    """The messages of all warnings on reading a drawing, and of the error if there is one."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            parse_svg(text, name="a.svg", dialect=dialect, assets=assets)
        except ValueError as error:
            return [str(error)]
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize("end", ["&#10;", "&#13;", "&#x85;", "&#x2028;"])
class TestLineBreaks:
    """Messages stay on one line even if they quote attributes that contain line breaks."""

    def test_a_warning_is_one_line(self, end):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            parse_svg(drawing(f'<rect fill="a b{end}c" width="1" height="1"/>'), name="a.svg")
        assert caught
        for warning in caught:
            assert len(str(warning.message).splitlines()) == 1
            assert str(warning.message).startswith("a.svg: ")

    @pytest.mark.parametrize(
        "element",
        [
            '<rect width="1{}2" height="1"/>',
            '<polygon points="1 2{}x"/>',
            '<g transform="turn{}(3)"/>',
            '<image href="no{}where.png" width="1" height="1"/>',
            '<texture texid="t" filename="no{}where.png"/>',
            '<textri points="0 0 9 0 0 9" uvs="0 0 1 0 0 1" texid="t{}"/>',
            '<image href="data:image/png;base64,{}!" width="1" height="1"/>',
            '<colortri points="0 0 9 0 0{}" colors="?{}"/>',
        ],
    )
    def test_an_error_is_one_line(self, end, element, tmp_path):
        text = drawing(element.replace("{}", end))
        with pytest.raises(ValueError, match=r"^a\.svg:2: <") as raised:
            parse_svg(text, name="a.svg", assets=tmp_path, strict=True)
        assert len(str(raised.value).splitlines()) == 1
        for dialect in ("svg", "course"):
            messages = messages_of(text, dialect, tmp_path)
            assert messages or dialect == "course"
            for message in messages:
                assert len(message.splitlines()) == 1
                assert message.startswith(("a.svg: ", "a.svg:2: "))


@pytest.mark.parametrize(
    "element, notice",
    [
        ('<rect style="fill:red; foo"/>', "ignored as invalid: style of <rect> (line 2: a part is"),
        ('<rect style="fill:"/>', "ignored as invalid: fill of <rect> (line 2: "),
        ('<rect style="display:foo"/>', "ignored as invalid: display of <rect>"),
        ('<rect opacity="bad"/>', "of <rect> (line 2: expected a number in 0..1, got 'bad')"),
        ('<rect fill="var(--a)"/>', "without effect: fill of <rect>"),
        ('<rect style="transform:translateZ(0)"/>', "without effect: transform of <rect>"),
        ('<rect style="-webkit-filter:blur(2px)"/>', "without effect: -webkit-filter of <rect>"),
        ('<g style="transform-box:stroke-box;transform:scale(2)"/>', "taken as fill-box"),
        ('<h:link xmlns:h="http://www.w3.org/1999/xhtml" rel="stylesheet" href="a.css"/>',
         "without effect: href of <h:link> (line 2)"),
        ('<defs><animate href="#a"/></defs>', "not drawn: <animate> (line 2)"),
        ('<linearGradient id="g"><stop><set/></stop><stop/></linearGradient>'
         '<rect width="9" height="9" fill="url(#g)"/>', "not drawn: <set> (line 2)"),
        ('<clipPath id="c"><rect width="9" height="9"><animate/></rect></clipPath>'
         '<rect width="9" height="9" clip-path="url(#c)"/>', "not drawn: <animate> (line 2)"),
    ],
)  # fmt: skip
def test_what_has_no_effect_is_named(element, notice):
    with pytest.warns(UserWarning) as caught:
        parse_svg(drawing(element))
    assert len(caught) == 1 and notice in str(caught[0].message)
    with pytest.raises(ValueError, match=r":2: <"):
        parse_svg(drawing(element), strict=True)


def test_keywords_are_not_case_sensitive_and_invalid_ones_do_not_count(recwarn):
    style = "display:NONE"
    scene = parse_svg(drawing(f'<rect width="9" height="9" style="{style}"/>'))
    assert len(scene.triangles) == 0 and not recwarn.list
    style = "display:none;display:foo"
    assert len(parse_svg(drawing(f'<rect width="9" height="9" style="{style}"/>')).triangles) == 0


def test_an_error_is_counted_once_for_each_element_and_not_for_each_copy():
    body = '<rect id="a" width="9" height="9" style="fill:red; foo"/>' + '<use href="#a"/>' * 3
    with pytest.warns(UserWarning, match=r"style of <rect> \(line 2: "):
        parse_svg(drawing(body))


def test_a_style_sheet_of_another_file_is_named():
    text = f'<?xml version="1.0"?>\n<?xml-stylesheet href="a.css"?>\n{drawing()}'
    with pytest.warns(UserWarning, match=r"href of <\?xml-stylesheet\?> \(line 2\)"):
        parse_svg(text)


@pytest.mark.parametrize(
    "options, told",
    [
        ({"fit": "cover", "dialect": "course"}, "`fit` applies to dialect 'svg' only"),
        ({"fit": "cover", "transform": np.eye(3)}, "give `fit` or `transform`, not both"),
        ({"height": 10.5}, "<svg>: `height` must be an integer in 1..1048576; got 10.5"),
        ({"width": True}, "<svg>: `width` must be an integer in 1..1048576; got True"),
        ({"tolerance": 1e9}, "`tolerance` must be"),
    ],
)
def test_options_without_a_meaning_are_refused(options, told):
    with pytest.raises(ValueError, match=told):
        parse_svg(drawing(), **options)
