"""Declares most options of `softras2d fit`, with their help texts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple, get_args

import typer

from .. import names
from .fit_paths import BUNDLED

_RESULT = "The result"
SEARCH = "The optimisation"
_FILM = "Films"

SECONDS = 30.0
"""Time limit, in seconds, of a command that is given neither `--seconds` nor `--steps`."""


class Rectangle(NamedTuple):
    """A rectangle of pixels: its left edge `x`, its upper edge `y`, and its size."""

    x: int
    y: int
    width: int
    height: int


def parse_rectangle(text: str | Rectangle) -> Rectangle:
    """Parse `X,Y,WIDTH,HEIGHT`: four integers, of which the last two must be above 0.

    A `Rectangle` is returned unchanged. Raises `typer.BadParameter` for other text.
    """
    if isinstance(text, Rectangle):
        return text
    try:
        x, y, width, height = (int(number) for number in text.split(","))
    except ValueError:
        width = height = x = y = 0
    if width < 1 or height < 1:
        raise typer.BadParameter(f"{text!r} is not X,Y,WIDTH,HEIGHT, such as 120,80,200,150.")
    return Rectangle(x, y, width, height)


Targets = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="PHOTO",
        show_default=False,
        help="Image to fit; - is standard input. Several images are the frames of a film, with "
        "--animation. Default: a bundled picture.",
    ),
]
Triangles = Annotated[
    int,
    typer.Option("-n", "--triangles", help="Maximum number of triangles.", rich_help_panel=_RESULT),
]
Family = Annotated[
    names.FitFamily,
    typer.Option(
        help="layers: separate triangles that may overlap; mesh: triangles that share vertices "
        "and tile the image.",
        rich_help_panel=_RESULT,
    ),
]
Shading = Annotated[
    names.FitShading | None,
    typer.Option(
        help="Colours. flat: one per triangle; gouraud: interpolated between vertices; linear "
        "(mesh only): interpolated, with separate corner colours for each triangle.",
        show_default="flat for layers, gouraud for a mesh",
        rich_help_panel=_RESULT,
    ),
]
Translucent = Annotated[
    bool,
    typer.Option(
        "--translucent",
        help="Also fit the opacity of each triangle (layers only).",
        rich_help_panel=_RESULT,
    ),
]
Output = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT.svg|png|gif|npz|s2d|json",
        show_default="PHOTO.fit.svg",
        help="File to write; may be repeated. svg: vector image; png: image; gif: animation of "
        "the fit; npz: the whole fit, for --resume and --start; s2d: compact binary; json: "
        "report; -: an SVG on standard output.",
        rich_help_panel=_RESULT,
    ),
]
Digits = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=6,
        help="Make SVG files small: round coordinates to this many decimals, and colours to 8 "
        "bits.",
        show_default="exact numbers",
        rich_help_panel=_RESULT,
    ),
]
CompareIn = Annotated[
    str | None,
    typer.Option(
        metavar="chromium|PATH",
        help="After the fit, show the SVG in this browser, without a window, and print how much "
        "its picture differs from the image of the fit. chromium: Chromium or Chrome, whichever is "
        "installed; or the command or path of either.",
        rich_help_panel=_RESULT,
    ),
]
Animation = Annotated[
    Path | None,
    typer.Option(
        metavar="OUT.svg|gif",
        help="Fit the frames of a film, and write it as an animation.",
        rich_help_panel=_FILM,
    ),
]
FrameSteps = Annotated[
    int,
    typer.Option(
        min=1,
        help="Optimizer steps of each frame after the first. The first takes --steps, or 500.",
        rich_help_panel=_FILM,
    ),
]
Temporal = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Weight of changes between frames where the film stands still, relative to the error. "
        "Films with a higher value flicker less.",
        rich_help_panel=_FILM,
    ),
]
Fps = Annotated[
    float,
    typer.Option(
        min=0.1, max=50.0, help="Frames per second of the animation.", rich_help_panel=_FILM
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        help="Stop after this many seconds, counted from the start of the command.",
        show_default=f"{SECONDS:.0f}",
        rich_help_panel=SEARCH,
    ),
]
Steps = Annotated[
    int | None,
    typer.Option(
        help="Stop after this many optimizer steps, instead of a number of seconds. With --resume, "
        "the steps of the earlier fit count too.",
        rich_help_panel=SEARCH,
    ),
]
Solver = Annotated[names.Solver, typer.Option(help="Optimizer.", rich_help_panel=SEARCH)]
Size = Annotated[
    int | None,
    typer.Option(
        metavar="PIXELS",
        help="Longer side, in pixels, of the image during the fit; the result has the photo's "
        "size.",
        show_default="256 for layers, 1024 for a mesh",
        rich_help_panel=SEARCH,
    ),
]
Seed = Annotated[int, typer.Option(help="Random seed.", rich_help_panel=SEARCH)]
Softness = Annotated[
    str,
    typer.Option(
        metavar="FIRST[:LAST]",
        help="Width of the soft edges of layers, in pixels. Two numbers: at the start, and from "
        "the middle of the fit on.",
        rich_help_panel=SEARCH,
    ),
]
Colors = Annotated[
    names.ColorMethod,
    typer.Option(
        help="How colours are fitted. together: by the optimizer, with the geometry; solve: by "
        "linear least squares, again and again during the fit and at its end; polish: by linear "
        "least squares, only at the end.",
        rich_help_panel=SEARCH,
    ),
]
Loss = Annotated[
    names.Loss,
    typer.Option(
        help="Loss: squared error, absolute error (l1), or SSIM with squared error (ssim).",
        rich_help_panel=SEARCH,
    ),
]
Light = Annotated[
    names.LossSpace,
    typer.Option(
        help="Colour space in which the loss is computed: sRGB (display) or linear.",
        rich_help_panel=SEARCH,
    ),
]
Weights = Annotated[
    Path | None,
    typer.Option(
        metavar="IMAGE",
        help="Image that weights the error of each pixel: brighter pixels count more.",
        rich_help_panel=SEARCH,
    ),
]
Focus = Annotated[
    list[Rectangle] | None,
    typer.Option(
        metavar="X,Y,WIDTH,HEIGHT",
        parser=parse_rectangle,
        help="Rectangle, in pixels of the photo, in which errors count ten times as much; may be "
        "repeated, and multiplies --weights.",
        rich_help_panel=SEARCH,
    ),
]
Start = Annotated[
    str,
    typer.Option(
        metavar="|".join([*get_args(names.FitStart), "FILE"]),
        help="Initial triangles. error: layers begin with none, and triangles are added during the "
        "fit, where the error is largest; a mesh gets its vertices there before the first step. "
        "uniform, delaunay (random, denser where the image changes), or an SVG or NPZ file: all "
        "triangles are there from the start, and none are added.",
        rich_help_panel=SEARCH,
    ),
]
Resume = Annotated[
    Path | None,
    typer.Option(
        metavar="FIT.npz",
        help="Continue a saved fit with its settings; only --seconds, --steps and --output apply.",
        rich_help_panel=SEARCH,
    ),
]
Watch = Annotated[
    bool,
    typer.Option("--watch", help="Show the fit in the browser while it runs."),
]
Browser = Annotated[
    bool,
    typer.Option(
        "--browser/--no-browser",
        help="With --watch: open the page in the browser, or only print its address.",
    ),
]


class FilmOptions(NamedTuple):
    """The values of the options that apply only to films, and of `--digits`.

    - `animation`: file to write.
    - `frame_steps`: optimizer steps of each frame after the first.
    - `temporal`: weight of changes where the film stands still, relative to errors.
    - `fps`: frames per second of the animation.
    - `digits`: decimals of coordinates in an SVG; None for the default, which is 1.
    """

    animation: Path
    frame_steps: int
    temporal: float
    fps: float
    digits: int | None


class PictureOptions(NamedTuple):
    """The values of the options for fitting one picture that are not settings of the optimisation.

    - `target`: the picture to fit; None for the bundled one, `-` for standard input.
    - `outputs`: the files to write, from `--output`; `-` is an SVG on standard output.
    - `digits`: decimals of coordinates in an SVG; None for exact numbers.
    - `compare_in`: command or path of the browser in which the SVG is compared with the fit; None
      for no comparison.
    - `weights`: file of the image that weights the error of each pixel, or None.
    - `focus`: rectangles, in pixels of the picture, in which errors count more; perhaps none.
    - `start`: name of a kind of start, such as `error`, or a file.
    - `resume`: file of the saved fit to continue; None for a new fit.
    - `watch`: whether a page shows the fit while it runs.
    - `browser`: whether that page is opened in the browser.
    """

    target: Path | None
    outputs: list[Path]
    digits: int | None
    compare_in: str | None
    weights: Path | None
    focus: Sequence[Rectangle]
    start: str
    resume: Path | None
    watch: bool
    browser: bool

    @property
    def values(self) -> dict[str, object]:
        """The values of some arguments of `fit`, by name, for `fit_errors.errors_name_options`.

        They are `target`, `weights`, `start` and `resume`. Without a target, the value of `target`
        is the name of the bundled picture. `weights` and `resume` are None if they were not given;
        `start` is the text of `--start` or its default.
        """
        return {
            "target": self.target or BUNDLED, "weights": self.weights, "start": self.start,
            "resume": self.resume,
        }  # fmt: skip
