"""Dialect `svg`: what is not drawn is named in one warning, and refused by `strict`."""

import warnings

import numpy as np
import pytest

from softras2d.io.svg.reading.reader import parse_svg

NS = 'xmlns="http://www.w3.org/2000/svg"'


def read(body, **options):
    return parse_svg(f'<svg {NS} width="100" height="80">{body}</svg>', **options)


def test_one_warning_names_everything_ignored():
    body = (
        "<text>hi<tspan>x</tspan></text>\n<text/>"
        '<rect width="4" height="4" rx="1" fill="url(#a) red" filter="url(#f)"><animate/></rect>'
        '<defs><pattern id="p"/></defs>\n<rect width="9" height="9" style="fill: url(#p) lime"/>'
        '<rect width="-4" height="4"/><i:namedview xmlns:i="urn:i"><i:x/></i:namedview>'
    )
    with pytest.warns(UserWarning) as caught:
        scene = read(body)
    assert np.asarray(scene.colors)[-1, 0].tolist() == [0, 1, 0]
    assert str(caught[0].message) == (
        "<svg>: not drawn: <text> (2 times, first in line 1), <animate> (line 2); "
        "without effect: filter of <rect> (line 2: url(#f)), "
        "fill of <rect> (line 3: patterns are not drawn); "
        "ignored as invalid: width of <rect> (line 3: must not be negative)."
    )
    assert len(caught) == 1
    assert caught[0].filename == __file__ or "parse_svg" not in str(caught[0].filename)


@pytest.mark.parametrize(
    ("body", "cause"),
    [
        ("<text>a</text>", "<text>"),
        ("<foreignObject/>", "<foreignObject>"),
        ('<rect width="9" height="9"><animate/></rect>', "<animate>"),
        ("<g><animateTransform/></g>", "<animateTransform>"),
        ("<animateMotion/>", "<animateMotion>"),
        ("<set/>", "<set>"),
        ('<g filter="url(#x)"/>', "filter of <g>"),
        ('<g mask="url(#x)"/>', "mask of <g>"),
        ('<g style="mix-blend-mode: multiply"/>', "mix-blend-mode of <g>"),
        ('<path d="M0 0h9" marker-end="url(#x)"/>', "marker-end of <path>"),
        ('<path d="M0 0h9" style="marker: url(#x)"/>', "marker of <path>"),
        ('<path d="M0 0h9v9" fill="url(#x)"/>', "fill of <path>"),
        ('<path d="M0 0h9v9" stroke="url(#x)"/>', "stroke of <path>"),
    ],
)
def test_everything_that_is_not_supported_is_named(body, cause):
    pattern = '<pattern id="x" width="1" height="1"><rect width="1" height="1"/></pattern>'
    with pytest.warns(UserWarning) as caught:
        read(f"{pattern}\n{body}")
    assert f"{cause} (line 2" in str(caught[0].message)
    assert len(caught) == 1
    with pytest.raises(ValueError, match=r"^<svg>:2: <"):
        read(f"{pattern}\n{body}", strict=True)


def test_strict_refuses_the_first_thing_that_is_not_drawn():
    with pytest.raises(ValueError, match=r"^<svg>:2: <rect> filter: url\(#f\)\.$"):
        read('<circle r="3"/>\n<rect width="4" height="4" filter="url(#f)"/>', strict=True)
    with pytest.raises(ValueError, match=r"^<svg>:1: <text> not drawn\.$"):
        read("<text>a</text>", strict=True)


@pytest.mark.parametrize(
    "body",
    [
        # These elements are not displayed, so their errors do not matter.
        '<rect width="4" height="4" fill="#qqq" filter="url(#f)" style="rx: 2" display="none"/>',
        '<g style="display: none"><text>a</text></g><text systemLanguage="xx">b</text>',
        '<linearGradient id="g" href="#none"/><clipPath id="c" clip-path="url(#none)"/>',
        # The first shape of an isolated group has nothing below it to blend with.
        '<g style="isolation: isolate"><desc/><rect width="9" height="9" '
        'style="mix-blend-mode: overlay"/></g>',
    ],
)
def test_what_cannot_change_the_image_is_not_named(body):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(body, strict=True)


@pytest.mark.parametrize(
    "body",
    [
        '<g style="isolation: isolate"><circle r="3"/>{}</g>',
        '<g style="isolation: auto">{}</g>',
        '<g style="isolation: isolate"><defs>{}</defs></g><use href="#r"/>',
        '<g style="isolation: isolate"><g><circle r="3"/>{}</g></g>',
    ],
)
def test_blend_modes_over_something_are_named(body):
    rect = '<rect id="r" width="9" height="9" style="mix-blend-mode: overlay"/>'
    with pytest.warns(UserWarning, match="without effect: mix-blend-mode of <rect>"):
        read(body.format(rect))


def test_no_warning_without_need():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read('<g id="a" class="b" stroke-dasharray="none" mask="none" xml:space="preserve"/>')


@pytest.mark.parametrize("child", ['<use href="#t"/>', "<text>x</text>"])
def test_text_in_a_clip_path_is_named(child):
    body = (
        f'<defs><text id="t">x</text><clipPath id="c">{child}</clipPath></defs>'
        '<rect width="9" height="9" clip-path="url(#c)"/>'
    )
    with pytest.warns(UserWarning, match="not drawn: <text>"):
        read(body)
