"""Errors and warnings of drawings: one line with the file and the line of the element."""

import warnings

import numpy as np
import pytest

from softras2d.io.images import write_image
from softras2d.io.svg.reader import parse_svg

HUGE = "1e39"
"""Finite as Python reads it, and beyond float32."""


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
    """The warnings of reading a drawing, and the error if there is one."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            parse_svg(text, name="a.svg", dialect=dialect, assets=assets)
        except ValueError as error:
            return [str(error)]
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize("end", ["&#10;", "&#13;", "&#x85;", "&#x2028;"])
class TestLineBreaks:
    """Attributes may contain line breaks, and messages quote attributes."""

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
