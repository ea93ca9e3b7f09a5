"""`softras2d compare`: compares an image with another image, or with the exact image of an SVG."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from .. import names
from . import options
from .options import RenderOptions, Size
from .session import session

if TYPE_CHECKING:
    import numpy as np

    from ..comparison.compare import Comparison

_DRAWING = ".svg"
"""Suffix, in either case, of files that are rendered to be compared; others are read as images."""

_SAMPLES = 16
"""Default number of samples per pixel with which an SVG drawing is rendered."""

Actual = Annotated[Path, typer.Argument(metavar="A.png", show_default=False, help="Image to test.")]
Expected = Annotated[
    Path,
    typer.Argument(
        metavar="B.png|B.svg",
        show_default=False,
        help="Expected image of the same size; or a drawing, which is rendered at the size of A.",
    ),
]
Against = Annotated[
    int | None,
    typer.Option(
        metavar="SAMPLES",
        help="Samples per pixel at which a drawing is rendered: 1, 4, 9, 16, 64 or 256. "
        f"Default: {_SAMPLES}.",
    ),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DIFF.png",
        help="Write a picture in which the pixels that differ are coloured, from red to white, "
        "over a dark grey copy of B.",
    ),
]
Tolerance = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        help="Difference of a channel up to which pixels count as equal, where 1 is the full "
        "range. Default: 1/255, one level of an 8-bit image.",
    ),
]


def compare_files(
    actual: Actual,
    expected: Expected,
    against: Against = None,
    output: Output = None,
    tolerance: Tolerance = None,
    dialect: options.Dialect = "svg",
) -> None:
    """Compare an image with another one, or with the exact image of an SVG drawing.

    [bold]softras2d compare new.png old.png -o difference.png[/bold]

    [bold]softras2d compare mine.png scene.svg --against 64[/bold]

    Exit code: 0 if no pixel differs by more than the tolerance, 1 if one does, 2 after an error.
    """
    with session(error_code=2):
        from ..comparison.compare import compare
        from ..comparison.tolerance import ONE_LEVEL
        from ..io.images import read_image, write_image

        if actual.suffix.lower() == _DRAWING:
            raise ValueError(f"{actual}: the image to test cannot be a drawing; B can be one.")
        image = read_image(actual)
        if expected.suffix.lower() == _DRAWING:
            target = _exact_image(
                expected, image, _SAMPLES if against is None else against, dialect
            )
        elif against is not None:
            raise ValueError(f"{expected}: --against applies to an .svg drawing only.")
        else:
            target = read_image(expected)
        if image.shape[:2] != target.shape[:2]:
            sizes = " and ".join(f"{w} x {h}" for h, w in (image.shape[:2], target.shape[:2]))
            raise ValueError(f"{actual} and {expected} must have the same size; got {sizes}.")
        comparison = compare(image, target, tolerance=ONE_LEVEL if tolerance is None else tolerance)
        _print(comparison, actual, expected)
        if output is not None:
            write_image(output, comparison.picture)
            Console(soft_wrap=True, highlight=False).print(f"difference: {output}", markup=False)
        if not comparison.matches:
            raise typer.Exit(1)


def _exact_image(
    drawing: Path, image: "np.ndarray", samples: int, dialect: names.SvgDialect
) -> "np.ndarray":
    """Render an SVG drawing at the size of `image`, with `samples` samples per pixel.

    - `image`: floats `[height, width, channels]`. If all of them are multiples of 1/255 in 0..1, as
      in an 8-bit file, the result is rounded to such values, too.
    - `dialect`: dialect of SVG in which the drawing is read.

    Returns floats `[height, width, 3 or 4]` in 0..1, in sRGB with straight alpha. Raises
    `ValueError`, which names the option `--against`, for a number of samples that is not allowed.
    """
    from ..io.pixel_values import round_to_levels
    from .render_steps import make_plan, read_scene, render_image

    height, width, _ = image.shape
    settings = RenderOptions(samples, Size(width, height), dialect)
    scene, height, width = read_scene(drawing, settings)
    try:
        plan = make_plan(scene, height, width, settings)
    except ValueError as error:
        raise ValueError(str(error).replace("--samples", "--against")) from None
    exact = render_image(scene, plan)
    # A renderer that computes the exact image and stores it in 8 bits must differ in no pixel.
    is_rounded = (round_to_levels(image) == image).all()
    return round_to_levels(exact) if is_rounded else exact


def _print(comparison: "Comparison", actual: Path, expected: Path) -> None:
    """Print a line that says whether the two images match, and a table of the measures.

    `actual` and `expected` are the files that were compared.
    """
    console = Console(highlight=False, soft_wrap=True)
    verdict, style = ("matches", "green") if comparison.matches else ("differs from", "bold red")
    console.print(f"{actual} {verdict} {expected}", style=style, markup=False)
    table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, value in comparison.rows():
        table.add_row(name, value)
    console.print(table)
