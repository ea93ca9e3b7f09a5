"""Mutated drawings are read as valid scenes, or refused in one line that names the file.

A failure prints the number and the text of its case; `cases/fuzzing.py` says how to repeat it.
"""

import random
import re
import signal
import warnings

import jax
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.io.svg.reading.reader import read_svg, svg_size

from ..cases.fuzzing import cases

LONGEST = 30
"""Time limit for one drawing, in seconds, on a slow machine."""

HAND_WRITTEN = (
    """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 40 30" width="80" height="60">
<defs><g id="a"/></defs><g transform="translate(1 2) rotate(30, 4, 5) scale(2)" opacity=".5">
<polyline points="1,1 9,1 9,9 1,9 5,-3" fill="none" stroke="#0f0" stroke-width="2%"
 stroke-linejoin="round" stroke-linecap="round" stroke-opacity="50%"/>
<polygon points="1 1 9 9 9 1 1 9" style="fill: lab(50% 40 20); fill-rule: evenodd"/></g>
<line x1="1in" y1="2pt" x2="3mm" y2="4" stroke="rgb(10% 20% 30%)" stroke-miterlimit="3"/>
<colortri points="1 2 3 4 5 6" colors="1 0 0 1 0 1 0 .5 0 0 1 1"/></svg>""",
    """<svg width="200px" height="100"><g transform="matrix(1,0,0,1,5,5) skewX(10)">
<rect x="1" y="2" width="30" height="20" fill="#ff0000" stroke="#00ff00" fill-opacity=".5"/>
<polygon points="10,10 90,10 20,80 50,-5 80,80" fill="#0000ff" stroke="#000000"/>
<line x1="0" y1="0" x2="200" y2="100" stroke="#123456"/><rect x="3" y="3" fill="#000000"/>
<image x="1" y="1" width="9" height="9" xlink:href="PIXELS"/>
</g><polyline points="1,2 3,4 5,6" stroke="#ff00ff"/></svg>""",
    """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 80 60" width="80" height="60">
<style>.a, g > path { fill: url(#l) } #p { stroke: red !important }</style>
<defs><linearGradient id="l" spreadMethod="reflect" x2=".3"><stop offset="0" stop-color="red"/>
<stop offset="50%" stop-color="lime" stop-opacity=".5"/></linearGradient>
<radialGradient id="r" href="#l" fx=".3" fr=".1" gradientTransform="rotate(9)"/>
<clipPath id="c" clipPathUnits="objectBoundingBox"><circle cx=".5" cy=".5" r=".4"/></clipPath>
<symbol id="s" viewBox="0 0 9 9"><ellipse cx="5" cy="5" rx="4" ry="3"/></symbol></defs>
<g opacity=".5" clip-path="url(#c)"><path id="p" d="M1 1C30 5 9 40 50 30S9 9 60 5A9 5 30 0 1 3 40z
m9 9 l5 5 -5 3z" stroke-dasharray="3 1" stroke-linejoin="miter-clip"/><rect class="a" x="20"
y="20" width="40" height="30" rx="5" stroke="blue" paint-order="stroke"/></g>
<use href="#s" x="5" width="30" height="20" fill="url(#r)" transform-origin="center"/>
<switch><use href="#p" systemLanguage="en" vector-effect="non-scaling-stroke"/></switch>
<svg x="40" y="5" width="50%" height="20" viewBox="0 0 9 9"><circle r="5" opacity=".5"
fill="url(#r)" stroke="url(#l)"/></svg></svg>""",
)

NUMBERS = (
    "0", "-0", "1", "-1", "1e38", "-1e38", "1e39", "1e300", "-1e308", "1e-300", "1e999", "nan",
    "inf", "1e155", "16777217", "0.1", ".5.5", "1e", "--1", "+", "1_0", "65536", "9" * 400, "%",
    "1e7", "1e5",
)  # fmt: skip
WORDS = (
    "none", "inherit", "currentColor", "round", "square", "bevel", "evenodd", "hidden", "auto",
    "lab(1e308 1e308 0)", "oklch(1e308 1 9)", "color(srgb 2 0 0)", "hwb(1 2% 3%)", "url(#a) red",
    "url(", "rgb(", "hsl(1e308 1% 1%)", "matrix(0 0 0 0 0 0)", "scale(1e30)", "rotate(1e308)",
    "skewX(90)", "scale(0)", "calc(1px)", "((((((((((", "&#10;", "&#0;", "&amp;", "\u0661", "💥",
    "url(#c)", "url(#l)", "#p", "#s", "#c", "M0 0A1 1 0 00 5 5", "m1 1C1 1 9e9 1 1 1z", "reflect",
    "userSpaceOnUse", "5em", "50%", "3vmin", "miter-clip", "1 1e-9", "path('M0 0')",
    "!important", "xMidYMid slice", "0 0 1e-300 1e-300", "../x.png", "data:,", "#ff", "#",
)  # fmt: skip
ATTRIBUTES = (
    "transform", "style", "fill", "stroke", "stroke-width", "stroke-linejoin", "stroke-linecap",
    "stroke-opacity", "fill-opacity", "opacity", "points", "width", "height", "viewBox", "display",
    "x", "stroke-miterlimit", "visibility", "color", "fill-rule", "preserveAspectRatio", "href",
    "texid", "uvs", "colors", "filename", "data-fallback", "xmlns:svg", "stroke-dasharray", "rx",
    "x1", "d", "clip-path", "stroke-dashoffset", "stroke-linejoin", "paint-order", "r", "cx", "id",
    "class", "offset", "stop-color", "gradientTransform", "spreadMethod", "gradientUnits", "fr",
    "fx", "transform-origin", "font-size", "xmlns", "systemLanguage", "clipPathUnits", "xml:base",
)  # fmt: skip

_NUMBER = re.compile(r"[0-9]++(?:\.[0-9]++)?+")
_ELEMENT = re.compile(r"<[a-z][^<>]*+>")
_VALUE = re.compile(r'"[^"<>]*+"')

PIXELS = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA"
    "60e6kgAAAABJRU5ErkJggg=="
)
"""An image of one pixel, as a data URI."""


def mutated(text: str, rng: random.Random) -> str | bytes:
    """The text after one to six mutations, of tokens or of bytes."""
    for _ in range(rng.randint(1, 6)):
        text = rng.choice(MUTATIONS)(text, rng)
        if len(text) > 300_000:
            break
    if rng.random() < 0.1:
        data = bytearray(text.encode())
        for _ in range(rng.randint(1, 4)):
            position = rng.randrange(len(data) + 1)
            data[position : position + rng.randint(0, 3)] = rng.randbytes(rng.randint(0, 3))
        return bytes(data)
    return text


def replaced(pattern: re.Pattern, text: str, rng: random.Random, make) -> str:
    """The text with one to three matches of the pattern replaced by `make(match)`."""
    matches = list(pattern.finditer(text))
    chosen = rng.sample(matches, min(len(matches), rng.choice((1, 1, 1, 3))))
    for match in sorted(chosen, reverse=True, key=lambda match: match.start()):
        text = text[: match.start()] + make(match[0]) + text[match.end() :]
    return text


def extreme_numbers(text: str, rng: random.Random) -> str:
    return replaced(_NUMBER, text, rng, lambda _: rng.choice(NUMBERS))


def odd_values(text: str, rng: random.Random) -> str:
    return replaced(_VALUE, text, rng, lambda _: f'"{rng.choice(WORDS)}"')


def odd_attributes(text: str, rng: random.Random) -> str:
    def make(element: str) -> str:
        name, value = rng.choice(ATTRIBUTES), rng.choice(WORDS + NUMBERS)
        end = -2 if element.endswith("/>") else -1
        return f'{element[:end]} {name}="{value}"{element[end:]}'

    return replaced(_ELEMENT, text, rng, make)


def repeated(text: str, rng: random.Random) -> str:
    count = rng.choice((2, 2, 10, 300))
    return replaced(_ELEMENT, text, rng, lambda element: element * count)


def long_lists(text: str, rng: random.Random) -> str:
    count = rng.choice((2, 20, 1000))
    return replaced(_VALUE, text, rng, lambda value: f'"{(value[1:-1] + " ") * count}"')


def nested(text: str, rng: random.Random) -> str:
    count = rng.choice((1, 20, 2000))
    extra = rng.choice(("", ' opacity=".9"', ' transform="scale(1.1)"', ' transform="rotate(9)"'))
    return replaced(
        _ELEMENT, text, rng, lambda element: f"<g{extra}>" * count + element + "</g>" * count
    )


def cut(text: str, rng: random.Random) -> str:
    first = rng.randrange(len(text) + 1)
    return text[:first] + text[first + rng.choice((1, 1, 5, 200)) :]


def unclosed(text: str, rng: random.Random) -> str:
    return replaced(
        re.compile(r"</[a-z]+>|/>"), text, rng, lambda end: "" if end[1] != ">" else ">"
    )


def renamed(text: str, rng: random.Random) -> str:
    names = (
        "rect",
        "polygon",
        "polyline",
        "line",
        "image",
        "colortri",
        "textri",
        "g",
        "circle",
        "path",
        "use",
        "svg",
        "clipPath",
        "linearGradient",
        "style",
        "symbol",
        "switch",
        "text",
    )
    return replaced(re.compile(r"(?<=<)[a-z]+\b"), text, rng, lambda _: rng.choice(names))


MUTATIONS = (
    extreme_numbers, extreme_numbers, odd_values, odd_attributes, odd_attributes, repeated,
    long_lists, nested, cut, unclosed, renamed,
)  # fmt: skip


def read(path, dialect, rng):
    """Read a drawing as the command line does; require a valid scene or a one-line error."""
    size = {} if rng.random() < 0.3 else {"height": rng.choice((1, 60)), "width": 80}
    options = {
        "opacity": rng.random() < 0.8,
        "linear": rng.random() < 0.2,
        "frame": None if dialect == "svg" else rng.choice((None, False)),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            svg_size(path, dialect=dialect)
        except ValueError as error:
            check_line(path, error)
        try:
            scene = read_svg(path, dialect=dialect, **size, **options)
        except ValueError as error:
            check_line(path, error)
        else:
            sr.check(scene)


def check_line(path, error):
    message = str(error)
    assert "\n" not in message and len(message) < 2000, message
    assert message.startswith(str(path)), message


def too_long(*_: object) -> None:
    raise TimeoutError(f"one drawing took more than {LONGEST} s")


@pytest.mark.slow
def test_mutated_drawings_are_read_or_refused_in_one_line(tmp_path):
    texts = [
        scenes.path(name).read_text() for name in scenes.names() if not scenes.is_scripted(name)
    ]
    texts = [*(text for text in texts if len(text) < 100_000), *HAND_WRITTEN * 3]
    texts = [text.replace("PIXELS", PIXELS) for text in texts]
    path = tmp_path / "drawing.svg"
    count = 0
    before = signal.signal(signal.SIGALRM, too_long)
    try:
        for number, _ in cases():
            rng = random.Random(number)
            content = mutated(rng.choice(texts), rng)
            data = content if isinstance(content, bytes) else content.encode(errors="replace")
            path.write_bytes(data)
            for dialect in ("svg", "course"):
                signal.alarm(LONGEST)
                try:
                    read(path, dialect, rng)
                except Exception as error:
                    excerpt = data[:2000].decode(errors="replace")
                    raise AssertionError(f"case {number}, {dialect}: {excerpt}") from error
                finally:
                    signal.alarm(0)
            count += 1
            if count % 500 == 0:
                # Each number of triangles compiles further programs, which fill the memory.
                jax.clear_caches()
    finally:
        signal.signal(signal.SIGALRM, before)
    print(f"{count} drawings")
