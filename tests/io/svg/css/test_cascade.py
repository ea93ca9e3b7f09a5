"""Selectors match, declarations apply in the right order, and both take bounded work."""

import warnings

import pytest
import tinycss2

from softras2d.io.svg.css.selector_costs import selector_cost
from softras2d.io.svg.reading.reader import parse_svg

from ....cases.drawings import colors_at

RED, LIME, BLACK = [1, 0, 0], [0, 1, 0], [0, 0, 0]


def color(sheet, rect='<rect width="9" height="9" class="a b" id="r"/>', **options):
    """The colour of a rectangle within a group, under a style sheet."""
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="20" height="9"><style>{sheet}</style>'
        f'<g class="group">{rect}</g></svg>'
    )
    return colors_at(parse_svg(text, **options), [[5.03, 4.07]])[0].tolist()


@pytest.mark.parametrize(
    "selector",
    ["*", "rect", ".a", "rect.a.b", "#r", "g rect", "g > rect", ".group #r", "[width]",
     'rect[width="9"]', "[class~=b]", "svg .a", "circle, rect", "g rect:first-child", ":not(g)",
     "rect:nth-child(1)", "g > *", "rect:empty", ":nth-last-child(1 of .a)",
     ":nth-last-of-type(1 of .a)"],
)  # fmt: skip
def test_selectors_that_match(selector):
    assert color(f"{selector} {{ fill: red }}") == RED


@pytest.mark.parametrize(
    "selector",
    ["circle", ".c", "#a", "svg > rect", "rect + rect", "[height='3']", "rect:hover",
     ".group:empty"],
)  # fmt: skip
def test_selectors_that_do_not_match(selector):
    assert color(f"{selector} {{ fill: red }}") == BLACK


@pytest.mark.parametrize(
    ("sheet", "attributes"),
    [
        # More specific rules win, and later ones among equals.
        ("#r { fill: lime } .a { fill: red }", ""),
        (".a.b { fill: lime } .a { fill: red }", ""),
        (".a { fill: red } .b { fill: lime }", ""),
        # Attributes have the lowest rank. `style` has the highest, apart from `!important`.
        ("* { fill: lime }", 'fill="red"'),
        ("#r { fill: red }", 'style="fill: lime"'),
        ("* { fill: lime !important }", 'style="fill: red"'),
        ("* { fill: red !important }", 'style="fill: lime !important"'),
        (".a { fill: lime !important } #r { fill: red }", ""),
        (".a { fill: red !important } #r { fill: lime !important; fill: blue }", ""),
        # Invalid declarations have no effect.
        (".a { fill: lime } rect.b { fill: redd }", ""),
        ("rect.b { fill: lime !important; fill: redd !important } .a { fill: red }", ""),
        ("#r { fill: redd !important } .a { fill: red }", 'style="fill: lime; fill: redd"'),
        ("#r { fill: redd }", 'fill="lime" style="fill: 3px"'),
        ("* { fill: lime } rect:has(a), rect { fill: red }", ""),
        ("@media print { rect { fill: red } } @media all { rect { fill: lime } }", ""),
        # CSS comments hide their text. The marks of HTML comments are skipped, but not their text.
        ("rect { fill: red; /* fill: blue; */ ; fill: lime } /* rect { fill: red } */", ""),
        ("rect { fill: red } &lt;!-- rect { fill: lime } --&gt;", ""),
    ],
)
def test_the_winner_is_lime(sheet, attributes):
    rect = f'<rect width="9" height="9" class="a b" id="r" {attributes}/>'
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert color(sheet, rect) == LIME


def test_an_element_with_a_blank_is_not_empty():
    assert color("rect:empty { fill: red }", '<rect width="9" height="9"> </rect>') == BLACK


@pytest.mark.parametrize(
    "selector",
    ["p::before, rect", "rect, rect::after", "rect:first-line, .a", "g > rect::BEFORE, #r",
     ":before, rect:first-child, ::selection"],
)  # fmt: skip
def test_other_selectors_beside_a_pseudo_element_apply(selector):
    with pytest.warns(UserWarning, match="without effect: .*selector of <style>"):
        assert color(f"{selector} {{ fill: red }}") == RED


@pytest.mark.parametrize(
    "selector", ["rect::before", "rect:after, circle", "::first-letter", "rect::mystery, rect",
                 "rect:mystery, rect", "rect : before, rect", "rect:::before, rect"]
)  # fmt: skip
def test_pseudo_elements_match_nothing_and_unknown_ones_drop_the_rule(selector):
    with pytest.warns(UserWarning, match="without effect: selector of <style>"):
        assert color(f"{selector} {{ fill: red }}") == BLACK


def test_a_notice_names_only_the_selector_with_the_pseudo_element():
    with pytest.warns(UserWarning, match=r"selector of <style> \(line 1: p::before\)"):
        color("rect, p::before , g { fill: red }")


def test_what_is_not_supported_is_named():
    for sheet, name in (
        ("@import 'a.css';", "@import of <style>"),
        ("rect:has(a) { fill: red }", "selector of <style>"),
        ("rect { fill: }", "fill of <rect>"),
    ):
        with pytest.warns(UserWarning, match=name):
            color(sheet)
    with pytest.raises(ValueError, match=r"<svg>:1: <style> @import"):
        color("@import 'a.css';", strict=True)


@pytest.mark.parametrize(
    ("media", "is_match"),
    [
        ("", True), ("screen", True), ("ALL", True), ("only screen", True), ("print", False),
        ("not print", True), ("not all", False), ("print, screen", True),
        ("(min-width: 20px)", True), ("(min-width: 21px)", False), ("(max-height: 9px)", True),
        ("screen and (width >= 1em) and (height < 10px)", True),
        ("(10px < width <= 20px)", True), ("(10px > width)", False), ("(width = 20px)", True),
        ("(width: 19px) or (height: 9px)", True), ("not (width: 20px)", False),
        ("screen and (not ((width: 20px) and (height: 8px)))", True), ("(orientation: portrait)",
        False), ("(min-aspect-ratio: 2/1)", True), ("(aspect-ratio > 3)", False),
        ("(prefers-color-scheme: dark)", False), ("(prefers-color-scheme: light)", True),
        ("(hover)", False), ("(color)", True), ("screen print", False),
        ("(width: 20px) and", False), ("(width: 19px) and (mystery: 3)", False),
        ("screen, (mystery: 3)", True), ("(hover: none)", True), ("not (hover: hover)", True),
        ("(orientation)", True), ("(prefers-reduced-motion: reduce)", False),
        ("not screen and", False), ("not print and (width: 1px) foo", False),
        ("not print and foo", False), ("not and", False), ("not print, screen and", True),
        ("screen and (width: 1px) or (color)", False), ("(width: 1px) or (color)", True),
    ],
)  # fmt: skip
def test_media_queries_about_the_canvas(media, is_match):
    sheet = f"@media {media} {{ rect {{ fill: red }} }}".replace("<", "&lt;")
    assert color(sheet) == (RED if is_match else BLACK)


def test_unknown_media_queries_are_named():
    for media in (
        "(mystery: 3)",
        "screen and (mystery: 3)",
        "not (mystery: 3)",
        "(width: 2furlong)",
        "not (aspect-ratio: 1_0)",
        "not (hover: x)",
        "not (prefers-color-scheme: no-preference)",
        "not (orientation: round)",
        "not ((color) (color))",
        "not size(1)",
        # Features with keywords cannot be in a range.
        "(hover >= none)",
    ):
        with pytest.warns(UserWarning, match=r"without effect: @media of <style> \(line 1: .*\("):
            assert color(f"@media {media} {{ rect {{ fill: red }} }}") == BLACK


def test_a_sheet_with_an_integer_of_thousands_of_digits_in_its_media_is_left_out():
    text = (
        f'<svg width="9" height="9"><style media="(width: {"9" * 5000}px)">rect {{ fill: red }}'
        '</style><rect width="9" height="8"/></svg>'
    )
    with pytest.warns(UserWarning, match=r"without effect: media of <style> \(line 1: \(width"):
        assert colors_at(parse_svg(text), [[5.03, 4.07]])[0].tolist() == BLACK


def test_sheets_of_other_types_and_media_are_skipped():
    text = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><style type="text/x">'
        'rect { fill: red }</style><style media="print">rect { fill: red }</style>'
        '<rect width="9" height="8"/></svg>'
    )
    assert colors_at(parse_svg(text), [[5.03, 4.07]])[0].tolist() == BLACK


@pytest.mark.parametrize(
    ("sheet", "body", "message"),
    [
        # For a chain of descendant selectors, every choice of ancestors is tried.
        ("g g g g g g g x { fill: red } g g g g g g g .n { fill: red }",
         "<g>" * 300 + '<rect class="n"/>' + "</g>" * 300, "selectors; at most"),
        ("rect ~ rect { fill: red }", "<rect/>" * 9000, "selectors; at most"),
        # Only one choice of 40 among 40 ancestors fits, but all partial choices are tried.
        ("g " * 40 + ".n { fill: red }",
         "<g>" * 40 + '<rect class="n"/>' + "</g>" * 40, "selectors; at most"),
        ("x ~ rect ~ rect ~ rect { fill: red }", "<rect/>" * 600, "selectors; at most"),
        ("rect{}" * 25_000, "<rect/>", "more than 20000 selectors"),
    ],
)  # fmt: skip
def test_costly_selectors_are_refused(sheet, body, message):
    text = f'<svg width="9" height="9"><style>{sheet}</style>{body}</svg>'
    with pytest.raises(ValueError, match=message) as caught:
        parse_svg(text)
    assert "\n" not in str(caught.value)


def test_blanks_around_combinators_cost_nothing():
    sheet = "g  >  g > g > g , g > g>g , x  +  y { fill: red }"
    body = "<g>" * 300 + '<rect class="n"/>' * 3 + "</g>" * 300
    for text in (sheet, sheet * 40):
        parse_svg(f'<svg width="9" height="9"><style>{text}</style>{body}</svg>')


@pytest.mark.parametrize(
    ("selector", "looks_at_siblings"),
    [
        ("rect:nth-child(1)", (False, False)),
        (":not(:first-of-type)", (True, False)),
        (":nth-child(1 of .a)", (False, True)),
    ],
)
def test_functions_that_examine_all_siblings_cost_more(selector, looks_at_siblings):
    cost = selector_cost(tinycss2.parse_component_value_list(selector))
    assert cost is not None
    assert (cost.last_looks_at_siblings, cost.others_look_at_siblings) == looks_at_siblings


def test_selectors_that_take_cubic_time_are_not_supported():
    with pytest.warns(UserWarning, match="selector of <style>"):
        assert color(":nth-child(1 of :first-of-type) { fill: red }") == BLACK
