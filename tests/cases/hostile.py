"""Time limits, and large drawings and images, for tests of hostile files."""

import contextlib
import signal
import warnings
import zlib
from collections.abc import Iterator

import numpy as np

from softras2d.io.svg.reading.reader import parse_svg

from .png_files import png


@contextlib.contextmanager
def ends_within(seconds: int) -> Iterator[None]:
    """Raise `TimeoutError` if the body of the `with` takes more processor time, in seconds.

    Limits are loose: they catch quadratic algorithms, and do not measure time.
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
    """The scene of an SVG text, or the message of its error.

    The message must be one line that begins with the file name and the line number.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            return parse_svg(text, dialect=dialect, height=60, width=80, **options)
        except ValueError as error:
            message = str(error)
    assert message.startswith("<svg>:1: ") and "\n" not in message
    return message


def points(array):
    return " ".join(f"{x:.5g},{y:.5g}" for x, y in np.asarray(array).tolist())


def polygon(array, attributes=""):
    return f'<polygon points="{points(array)}" {attributes}/>'


def random(count, seed=0):
    return np.random.default_rng(seed).random((count, 2)) * 10


def low_poly(count: int) -> str:
    """Triangles as low-poly generators write them: one path with one colour for each."""
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


def spiral(count):
    angle = np.linspace(0, 100 * np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) / 80
    return np.concatenate([along * (angle + 1)[:, None], (along * (angle + 4)[:, None])[::-1]])


def grey_png(height, width, rows=b""):
    """A grey PNG of one bit per pixel."""
    rows = rows or bytes((width // 8 + 1) * height)
    return png(height, width, zlib.compress(rows, 9), bits=1, channels=1)
