"""Every parser takes linear time for any text; attributes are read, or refused in one line."""

import contextlib
from pathlib import Path

import numpy as np
import pytest

from softras2d.io.budget import Budget
from softras2d.io.svg.css import cascade, media_queries, property_values, style
from softras2d.io.svg.css.font_size import shorthand_size
from softras2d.io.svg.elements import css_transform, view_box
from softras2d.io.svg.values import css_color, numbers, path_data, transform_attribute, units
from softras2d.io.svg.values.transform_origin import transform_origin
from softras2d.io.svg.xml import assets, notices, tree

from ..cases.hostile import ends_within, outcome

LENGTH = 50_000


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
    "paint": property_values._paint,
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
    "background": property_values.background_color,
    "origin": lambda text: transform_origin(text, (0.0, 0.0, 1.0, 1.0), VIEWPORT, 16.0),
    "font": lambda text: shorthand_size(text, 16.0, VIEWPORT),
    "dashes": lambda text: property_values._dasharray(text, style.INITIAL, VIEWPORT, 16.0),
    "url": property_values.reference_of,
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
    """Colours with huge numbers become finite ones."""
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
