"""`softras2d render`: renders scene files to image files."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from .. import names
from . import options
from .options import RenderOptions
from .session import debugging, failure_line, one_line, print_message, session

Scenes = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCENE.svg",
        show_default=False,
        help="SVG files to render, - for standard input, or names of bundled scenes such as rings.",
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT.png|FOLDER",
        show_default=False,
        help="Image file to write; a folder, which is created if it does not exist; or - for PNG "
        "on standard output.",
    ),
]
Format = Annotated[
    names.ImageFormat,
    typer.Option("--format", help="Format of the images if the output is a folder."),
]
Truncate = Annotated[
    bool,
    typer.Option(
        "--truncate",
        help="Convert to 8 bits by truncating, as the rasterizer course does, instead of rounding.",
    ),
]
Tiled = Annotated[
    bool,
    typer.Option(
        "--tiled",
        help="Draw the image in tiles, which are written as they are drawn: for images larger than "
        "memory, up to 1048576 pixels a side, in PNG, TIFF or EXR. Uses every device.",
    ),
]
Tile = Annotated[
    int | None,
    typer.Option(
        "--tile",
        metavar="PIXELS",
        help="Side of a tile with --tiled, in pixels: a multiple of 32, or of 80 with 9 samples. "
        "Default: 1024, or 960 with 9 samples.",
        show_default=False,
    ),
]


def render_scenes(
    scenes: Scenes,
    output: Output,
    kind: Format = "png",
    truncate: Truncate = False,
    tiled: Tiled = False,
    tile: Tile = None,
    samples: options.Samples = 16,
    size: options.SizeOption = None,
    origin: options.Origin = None,
    window: options.Window = None,
    background: options.Background = None,
    fill_rule: options.FillRule = "inclusive",
    shading: options.Shading = "sample",
    pixel_filter: options.PixelFilter = "bilinear",
    level_filter: options.LevelFilter = "linear",
    anisotropy: options.Anisotropy = 1,
    lod_bias: options.LodBias = 0.0,
    coverage: options.CoverageKind = "sampled",
    soft_width: options.SoftWidth = 1.0,
    linear: options.Linear = False,
    dialect: options.Dialect = "svg",
    assets: options.Assets = None,
    frame: options.Frame = None,
    opacity: options.Opacity = True,
    tolerance: options.Tolerance = 0.02,
    strict: options.Strict = False,
    fit: options.Fit = None,
) -> None:
    """Render SVG scenes to images.

    [bold]softras2d render scene.svg -o scene.png --samples 16 --size 800x600[/bold]

    [bold]softras2d render scenes/*.svg -o pictures/ --dialect course --truncate[/bold]

    [bold]softras2d render rings -o rings.png[/bold]   (a bundled scene)

    [bold]softras2d render map.svg -o map.tif --size 50000 --tiled[/bold]   (larger than memory)

    If a scene fails, the others are still rendered; errors are listed at the end (exit code 1).
    """
    settings = RenderOptions(
        samples, size, dialect, assets, fill_rule, shading, pixel_filter, level_filter,
        anisotropy, frame, opacity, background, origin, linear, tolerance, strict, fit, window,
        coverage, soft_width, lod_bias,
    )  # fmt: skip
    with session() as console:
        tiling = _tiling(tiled, tile, output)
        targets = _targets(scenes, output, kind)
        started = time.perf_counter()
        failures: list[str] = []
        try:
            summary = _render_each(scenes, targets, settings, truncate, tiling, console, failures)
        finally:
            # Also after Ctrl-C: errors before it must not get lost.
            for failure in failures:
                print_message("error", failure, console)
        seconds = time.perf_counter() - started
        written = len(scenes) - len(failures)
        if len(scenes) > 1:
            summary = f"{written} of {len(scenes)} images in {seconds:.1f} s: {output}"
        if written:
            # Standard output is for the image alone if it goes there.
            Console(stderr=str(output) == "-", soft_wrap=True, highlight=False).print(
                summary, markup=False
            )
        if failures:
            raise typer.Exit(1)


class Tiling(NamedTuple):
    """The values of the options about tiles. `tile`: side of a tile in pixels; None: default."""

    tile: int | None


def _tiling(tiled: bool, tile: int | None, output: Path) -> Tiling | None:
    """Return the settings for drawing an image in tiles; None without the option `--tiled`.

    Raises `ValueError` for `--tile` without `--tiled`, and for `--tiled` with standard output.
    """
    if not tiled:
        if tile is not None:
            raise ValueError("--tile needs --tiled.")
        return None
    if str(output) == "-":
        raise ValueError("-: --tiled writes to a file, not to standard output.")
    return Tiling(tile)


def _render_each(
    scenes: list[Path],
    targets: list[Path],
    settings: RenderOptions,
    truncate: bool,
    tiling: Tiling | None,
    console: Console,
    failures: list[str],
) -> str:
    """Render each scene to the file of the same index in `targets`, and continue after errors.

    Returns a line about the last image that was written; empty if there is none. Appends one line
    to `failures` for each scene that failed. While `debugging()`, the first error is raised.

    - `settings`: how scenes are read and drawn.
    - `truncate`: the value of the option `--truncate`.
    - `tiling`: the settings of `--tiled`; None: images are not drawn in tiles.
    """
    from ..numerics.compiled_programs import drop_programs

    summary = ""
    with _progress_bar(len(scenes), console) as advance:
        for scene, target in zip(scenes, targets, strict=True):
            try:
                if tiling is None:
                    summary = _render(scene, target, settings, truncate)
                else:
                    summary = _render_tiled(scene, target, settings, truncate, tiling, console)
            except Exception as error:
                if debugging():
                    raise
                is_output = isinstance(error, OutputError)
                failures.append(one_line(error) if is_output else failure_line(error, scene))
            drop_programs()
            advance()
    return summary


def _targets(scenes: list[Path], output: Path, kind: str) -> list[Path]:
    """Choose the path of the image file of every scene; `-` is standard output.

    - `output`: the value of `--output`. It is a file if there is one scene, and `output` has a
      suffix and is no existing folder. Otherwise it is a folder, which is created.
    - `kind`: suffix of the files in a folder, without its dot. Their names are those of the scenes,
      and `stdin` for standard input.

    Raises `ValueError` if several scenes would be written to one file.
    """
    from ..io.outputs import WRITABLE

    suffix = output.suffix.lower()
    if str(output) == "-":
        if len(scenes) > 1:
            raise ValueError(f"-: {len(scenes)} scenes go into a folder, not to standard output.")
        return [output]
    if len(scenes) == 1 and suffix and not output.is_dir():
        return [output]
    if suffix in WRITABLE and not output.is_dir():
        raise ValueError(f"{output}: {len(scenes)} scenes go into a folder, not into one file.")
    targets = {}
    for scene in scenes:
        name = "stdin" if str(scene) == "-" else scene.stem
        target = output / f"{name}.{kind}"
        if target in targets:
            raise ValueError(
                f"{target}: both {targets[target]} and {scene} would be written there."
            )
        targets[target] = scene
    output.mkdir(parents=True, exist_ok=True)
    return list(targets)


def _render(path: Path, target: Path, settings: RenderOptions, truncate: bool) -> str:
    """Render one scene file to one image file; return a line about the image.

    - `path`: an SVG file, `-` for standard input, or the name of a bundled scene.
    - `target`: the image file; `-` is a PNG on standard output.
    - `settings`: how the scene is read and drawn.
    - `truncate`: whether values are truncated to 8 bits, instead of rounded.
    """
    from .render_steps import make_plan, read_scene, render_image, window_size

    started = time.perf_counter()
    scene, height, width = read_scene(path, settings)
    height, width = window_size(settings.window, height, width)
    image = render_image(scene, make_plan(scene, height, width, settings))
    seconds = time.perf_counter() - started
    _write(target, image, settings.linear, truncate)
    return (
        f"{target}: {width} x {height} pixels {_coverage_text(settings)}, "
        f"{scene.triangles.shape[0]} triangles, {1e3 * seconds:.0f} ms"
    )


def _render_tiled(
    path: Path,
    target: Path,
    settings: RenderOptions,
    truncate: bool,
    tiling: Tiling,
    console: Console,
) -> str:
    """Render one scene file to one image file, tile by tile; return a line about the image.

    `path`, `settings` and `truncate` are as in `_render`. `console` shows a progress bar. Raises
    `OutputError` for errors about the file `target`.
    """
    import jax

    from ..io.image_stream import check_stream
    from ..tiled.write_tiles import write_tiles
    from .render_steps import make_tiled_plan, read_scene, window_size

    with _errors_of_output():
        check_stream(target)
    started = time.perf_counter()
    scene, height, width = read_scene(path, settings)
    height, width = window_size(settings.window, height, width)
    plan = make_tiled_plan(scene, height, width, settings, tiling.tile)
    with _tile_bar(console) as report, _errors_of_output(named=target):
        write_tiles(
            target, scene, plan, devices=jax.local_devices(), linear=settings.linear,
            truncate=truncate, report=report,
        )  # fmt: skip
    return (
        f"{target}: {width} x {height} pixels {_coverage_text(settings)}, {plan.cut.count} tiles, "
        f"{scene.triangles.shape[0]} triangles, {time.perf_counter() - started:.1f} s"
    )


@contextmanager
def _tile_bar(console: Console) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar for the tiles of an image during a `with` block, on a terminal only.

    Yields the function to call after each tile, with the number of tiles done and of all tiles.
    """
    columns = (TextColumn("tiles"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    is_shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not is_shown) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


class OutputError(ValueError):
    """An error about the image file that is written; its message need not name the scene."""


@contextmanager
def _errors_of_output(named: Path | None = None) -> Iterator[None]:
    """In a `with` block, turn `ValueError` and `OSError` into `OutputError`.

    `named`: the path of the image file, or None. If it is given, a `ValueError` whose message does
    not begin with this path is about the scene, and is raised unchanged.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        line = one_line(error)
        if named is not None and isinstance(error, ValueError) and not line.startswith(f"{named}:"):
            raise
        raise OutputError(line) from error


def _write(target: Path, image: Any, linear: bool, truncate: bool) -> None:
    """Write an image to the file `target`; `-` is a PNG on standard output.

    - `linear`: whether the values of the image are linear light instead of sRGB, in which all
      formats but EXR store them.
    - `truncate`: whether values are truncated to 8 bits, instead of rounded.
    """
    from ..io.images import write_image

    with _errors_of_output():
        if str(target) != "-":
            write_image(target, image, linear=linear, truncate=truncate)
            return
        with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
            file = Path(folder) / "image.png"
            write_image(file, image, linear=linear, truncate=truncate)
            sys.stdout.buffer.write(file.read_bytes())
            sys.stdout.buffer.flush()


def _coverage_text(settings: RenderOptions) -> str:
    """The coverage mode of an image in words, such as `at 16 samples per pixel`."""
    return {
        "sampled": f"at {settings.samples} samples per pixel",
        "soft": f"with edges {settings.soft_width:g} pixels wide",
        "area": "with exact areas",
    }[settings.coverage]


@contextmanager
def _progress_bar(total: int, console: Console) -> Iterator:
    """Show a progress bar for `total` images during a `with` block.

    Yields the function to call after each image. For a single image, no bar is shown.
    """
    if total == 1:
        yield lambda: None
        return
    columns = (
        TextColumn("rendering"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[status]}"),
    )
    started = time.perf_counter()
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=total, status="")

        def advance() -> None:
            done = progress.tasks[task].completed + 1
            milliseconds = 1e3 * (time.perf_counter() - started) / done
            progress.update(task, completed=done, status=f"{milliseconds:.0f} ms per image")

        yield advance
