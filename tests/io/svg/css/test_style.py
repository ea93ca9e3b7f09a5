"""Colours in every notation, and style properties with inheritance."""

from typing import Any

import numpy as np
import pytest
import tinycss2.color4

from softras2d.io.budget import Budget
from softras2d.io.svg.css.cascade import Cascade
from softras2d.io.svg.css.computed_style import computed
from softras2d.io.svg.css.property_values import background_color
from softras2d.io.svg.css.style import INITIAL, PaintServer
from softras2d.io.svg.values.css_color import CURRENT, color_of
from softras2d.io.svg.values.units import Viewport
from softras2d.io.svg.xml.notices import Notices
from softras2d.io.svg.xml.tree import Element


@pytest.mark.parametrize(
    ("text", "rgba"),
    [
        ("red", (1, 0, 0, 1)),
        ("RebeccaPurple", (0.4, 0.2, 0.6, 1)),
        ("#f80", (1, 0x88 / 255, 0, 1)),
        ("#f808", (1, 0x88 / 255, 0, 0x88 / 255)),
        ("#FF8000", (1, 128 / 255, 0, 1)),
        ("#ff800080", (1, 128 / 255, 0, 128 / 255)),
        ("rgb(255, 128, 0)", (1, 128 / 255, 0, 1)),
        ("rgb( 999,128 , 0 )", (1, 128 / 255, 0, 1)),
        ("rgb(255 128 0 / 50%)", (1, 128 / 255, 0, 0.5)),
        ("rgba(255,128,0,.25)", (1, 128 / 255, 0, 0.25)),
        ("rgb(10%, 20.5%, 30%)", (0.1, 0.205, 0.3, 1)),
        ("rgb(10% 20.5% 30%)", (0.1, 0.205, 0.3, 1)),
        ("rgb(300, -5, 0)", (1, 0, 0, 1)),
        ("rgb(120% -5% 0%)", (1, 0, 0, 1)),
        ("hsl(120, 100%, 25%)", (0, 0.5, 0, 1)),
        ("hsl(120deg 100% 25% / .5)", (0, 0.5, 0, 0.5)),
        ("hwb(0 20% 40%)", (0.6, 0.2, 0.2, 1)),
        ("transparent", (0, 0, 0, 0)),
        ("color(srgb 0.25 0.5 1.5)", (0.25, 0.5, 1.5, 1)),
        ("color(srgb-linear 0.5 0 1)", (0.7353569, 0, 1, 1)),
        ("color(xyz 0.9504559 1 1.0890578)", (1, 1, 1, 1)),
        ("lab(100 0 0)", (1, 1, 1, 1)),
        ("lab(50 0 0)", (0.4663266, 0.4663266, 0.4663266, 1)),
        ("oklch(62.8% 0.25768 29.234)", (1, 0, 0, 1)),
        ("oklab(1 0 0)", (1, 1, 1, 1)),
    ],
)
def test_colors_by_hand(text, rgba):
    color: Any = color_of(text)
    np.testing.assert_allclose(color, rgba, atol=5e-4 if "lab" in text or "lch" in text else 1e-6)


def test_invalid_colors_are_none():
    for text in ("", "redd", "#12", "#ggg", "rgb(1 2)", "rgb(1% 2% x%)", "color(display-p3 1 0 0)"):
        assert color_of(text) is None
    assert color_of("currentColor") == "currentcolor"


def test_whole_numbers_are_parsed_as_by_tinycss2():
    """The package parses whole numbers itself, which is faster."""
    for value in range(0, 300, 7):
        reference: Any = tinycss2.color4.parse_color(f"rgb({value} {value} 9)")
        exact = tuple(np.clip(reference.to("srgb").coordinates, 0, 1))
        assert color_of(f"rgb({value},{value},9)") == (*exact, 1.0)


def test_percentages_give_exact_float32():
    values = np.random.default_rng(0).random((200, 3)).astype(np.float32)
    for value in values.astype(np.float64).tolist():
        color: Any = color_of("rgb({}% {}% {}%)".format(*(repr(v * 100) for v in value)))
        np.testing.assert_array_equal(np.array(color[:3], np.float32), np.array(value, np.float32))


VIEWPORT = Viewport(100.0, 100.0, 100.0, 100.0)


def style(parent=INITIAL, **attributes):
    """The computed style, and its notices. Underscores in `attributes` stand for hyphens."""
    notes = []
    plain = {name.replace("_", "-"): value for name, value in attributes.items()}
    declared = Cascade(Notices("a.svg", True), Budget(), 9, 9).declarations(
        Element("rect", "rect", plain, None, 1)
    )
    result = computed(
        declared, parent, VIEWPORT, lambda kind, name, detail: notes.append((kind, name))
    )
    return result, notes


def fill_of(result):
    """The RGBA of a fill that is a plain colour; None if it is invisible."""
    rgba = result.color if result.fill == CURRENT else result.fill
    if rgba is None:
        return None
    *color, alpha = rgba
    return (*color, alpha * result.fill_opacity) if alpha * result.fill_opacity > 0 else None


def test_attributes_are_inherited_and_replaced():
    parent, _ = style(fill="red", stroke="#00f", stroke_width="3", fill_opacity=".5")
    child, notes = style(parent, fill="lime", stroke_width="50%", id="x", points="1 2")
    assert child.fill == (0, 1, 0, 1)
    assert child.stroke == (0, 0, 1, 1)
    assert child.stroke_width == 50
    assert fill_of(child) == (0, 1, 0, 0.5)
    assert notes == []


def test_css_overrides_attributes():
    result, notes = style(
        fill="red", style="fill: rgb(0 0 255 / 50%) !important; stroke:lime;; stroke-width : 2px"
    )
    assert result.fill == (0, 0, 1, 0.5)
    assert result.stroke == (0, 1, 0, 1)
    assert result.stroke_width == 2
    assert notes == []
    assert style(style="fill:red;fill:lime /* green */")[0].fill == (0, 1, 0, 1)
    assert style(style="fill:red;fill:lime")[0].fill == (0, 1, 0, 1)
    assert style(style="fill:lime!important;fill:red")[0].fill == (0, 1, 0, 1)


def test_opacity_is_not_inherited_and_other_opacities_are():
    group, _ = style(opacity="50%", fill_opacity="0.5")
    assert (group.opacity, group.fill_opacity) == (0.5, 0.5)
    child, _ = style(group)
    assert (child.opacity, child.fill_opacity) == (1, 0.5)
    assert style(group, opacity="inherit")[0].opacity == 0.5
    assert style(opacity="7")[0].opacity == 1
    assert style(opacity="-7")[0].opacity == 0


def test_keywords_of_every_property():
    group, _ = style(fill="red", stroke_width="3", opacity=".5")
    for word, width in (("inherit", 3), ("unset", 3), ("initial", 1)):
        assert style(group, stroke_width=word)[0].stroke_width == width
    assert style(group, opacity="unset")[0].opacity == 1


def test_current_color_is_that_of_the_user():
    group, _ = style(color="red", fill="currentColor")
    assert fill_of(style(group)[0]) == (1, 0, 0, 1)
    assert fill_of(style(group, color="lime")[0]) == (0, 1, 0, 1)
    assert fill_of(style(group, color="currentColor")[0]) == (1, 0, 0, 1)


def test_font_sizes_scale_em():
    assert style(font_size="20px", stroke_width="2em")[0].stroke_width == 40
    assert style(stroke_width="2em", font_size="20")[0].stroke_width == 40
    assert style(stroke_width="2em")[0].stroke_width == 32
    assert style(style="font: bold 10px/2 serif; stroke-width: 2ex")[0].font_size == 10


def test_font_sizes_in_css_have_units():
    result, notes = style(font_size="20", style="font-size: 30; stroke-width: 1em")
    assert (result.font_size, result.stroke_width) == (20, 20)
    assert notes == [("ignored as invalid", "font-size")]
    # A number without a unit is a valid stroke width, even in CSS, but only 0 is a valid font size.
    assert style(style="stroke-width: 3; font-size: 0")[0].stroke_width == 3
    result, notes = style(style="font: 10 serif")
    assert (result.font_size, notes) == (16, [("ignored as invalid", "font")])


def test_the_font_shorthand_sets_the_size():
    result, notes = style(style="font: italic 700 10px/2 serif; stroke-width: 2em")
    assert (result.font_size, result.stroke_width, notes) == (10, 20, [])
    assert style(style="font: 10px a; font-size: 12px")[0].font_size == 12
    assert style(style="font-size: 12px; font: larger a")[0].font_size == pytest.approx(19.2)
    assert style(font_size="12", style="font: inherit")[0].font_size == 16
    group, _ = style(font_size="20")
    for keyword in ("inherit", "unset", "revert", "revert-layer"):
        assert style(group, style=f"font: {keyword}")[0].font_size == 20
        assert style(group, style=f"font-size: {keyword}")[0].font_size == 20
    assert style(group, style="font: initial")[0].font_size == 16


@pytest.mark.parametrize(
    ("background", "rgba"),
    [
        ("red", (1, 0, 0, 1)),
        ("url(a.png) no-repeat RGB(0 255 0 / 50%) 0 0", (0, 1, 0, 0.5)),
        ("linear-gradient(rgb(255,0,0), blue)", (0, 0, 0, 0)),
        ("linear-gradient( red , hsl(120, 100%, 50%))", (0, 0, 0, 0)),
        ("radial-gradient(circle at 9px, rgb(255,0,0), blue) 0 0, lime", (0, 1, 0, 1)),
        ("linear-gradient(rgb(255,0,0), blue),#00f", (0, 0, 1, 1)),
        ("image-set(linear-gradient(rgb(255,0,0), red) 1x) lime", (0, 1, 0, 1)),
        ("none", (0, 0, 0, 0)),
    ],
)
def test_the_background_colour_stands_outside_of_gradients(background, rgba):
    assert style(style=f"background: {background}")[0].background_color == rgba


@pytest.mark.parametrize(
    "background",
    ["bogus", "lime bogus", "lime, blue", "lime 1 1", "'a.png'", "#12", "var(--a)"],
)
def test_an_invalid_background_does_not_hide_one_of_lower_rank(background):
    result, notes = style(style=f"background-color: red; background: {background}")
    assert result.background_color == (1, 0, 0, 1)
    assert [name for _, name in notes] == ["background"]
    result, _ = style(
        style=f"background: url(a.png), red 0 1px / 50% auto; background:{background}"
    )
    assert result.background_color == (1, 0, 0, 1)


def test_extreme_backgrounds_are_invalid():
    for text in ("", "1" * 5000, "(" * 99 + ")" * 99):
        with pytest.raises(ValueError):
            background_color(text)


def test_the_background_takes_keywords_that_every_property_takes():
    parent, _ = style(style="background: red")
    assert style(parent)[0].background_color == (0, 0, 0, 0)
    assert style(parent, style="background: inherit")[0].background_color == (1, 0, 0, 1)
    assert style(parent, style="background: unset")[0].background_color == (0, 0, 0, 0)


def test_nothing_is_painted_without_paint():
    assert fill_of(style(fill="none")[0]) is None
    assert fill_of(style(fill="transparent")[0]) is None
    assert style()[0].stroke is None


def test_paint_servers_have_a_fallback():
    result, notes = style(fill="url(#a)", stroke="url( '#b' ) lime")
    assert result.fill == PaintServer("#a", False)
    assert result.stroke == PaintServer("#b", (0, 1, 0, 1))
    assert style(fill="url(#a) none")[0].fill == PaintServer("#a", None)
    assert notes == []


INVALID = "ignored as invalid"


def test_values_that_css_ignores_are_noted():
    parent, _ = style(fill="red")
    result, notes = style(
        parent, fill="redd", stroke_width="-1", fill_rule="odd", stroke_miterlimit="0.5"
    )
    assert result == parent
    assert notes == [
        (INVALID, name) for name in ("fill", "stroke-width", "fill-rule", "stroke-miterlimit")
    ]
    assert style(parent, fill="inherit") == (parent, [])


def test_properties_without_effect_are_noted():
    result, notes = style(mask="url(#m)", marker="none", style="filter:blur(2px)")
    assert result == INITIAL
    assert sorted(notes) == [("without effect", "filter"), ("without effect", "mask")]


def test_properties_without_effect_are_not_noted_if_css_turns_them_off():
    _, notes = style(mask="url(#m)", style="mask: NONE; mix-blend-mode: Normal")
    assert notes == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("opacity", "x"), ("fill-opacity", "nan"), ("stroke-width", "2qm"), ("stroke-width", "1e999"),
     ("stroke-miterlimit", "inf"), ("stroke-miterlimit", "1_000"), ("stroke-miterlimit", "٣"),
     ("stroke-opacity", "1px"), ("stroke-dasharray", "1 -2"),
     ("paint-order", "fill fill"), ("vector-effect", "non-scaling-stroke non-rotation"),
     ("font-size", "-3")],
)  # fmt: skip
def test_invalid_values_are_named_and_have_no_effect(name, value):
    result, notes = style(**{name.replace("-", "_"): value})
    assert notes == [(INVALID, name)]
    assert result == INITIAL
