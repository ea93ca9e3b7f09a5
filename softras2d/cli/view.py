"""`softras2d view`: shows scenes and images in the browser."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from .. import scenes
from . import options
from .session import session

if TYPE_CHECKING:
    from ..viewing.scene_file import ReadOptions
    from ..viewing.subject import Subject

STANDARD_INPUT = Path("-")

Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCENE.svg ...",
        show_default=False,
        help="SVG files or bundled scenes to view, and images to compare them with. - reads an SVG "
        "file from standard input. An SVG file or image that changes on disk is drawn again; "
        "textures and saved fits are read once.",
    ),
]
Port = Annotated[
    int | None,
    typer.Option(
        min=1024, max=65535, show_default=False, help="Port on 127.0.0.1. Default: a free one."
    ),
]
Browser = Annotated[
    bool,
    typer.Option(
        "--browser/--no-browser", help="Open the page in the browser, or only print its address."
    ),
]


def view_files(
    files: Files,
    port: Port = None,
    browser: Browser = True,
    dialect: options.Dialect = "svg",
    assets: options.Assets = None,
    frame: options.Frame = None,
    opacity: options.Opacity = True,
) -> None:
    """View scenes in the browser: zoom, pan, switch settings and inspect pixels.

    [bold]softras2d view scene.svg[/bold]

    [bold]softras2d view scenes/*.svg mine.png[/bold]

    The page is served on this machine alone. Ctrl-C ends the server.
    """
    with session(long_running=True) as console:
        # Refused before the heavy imports.
        for path in files:
            if not path.is_file() and not scenes.is_bundled(path) and path != STANDARD_INPUT:
                raise ValueError(f"{path}: no such file.")
        check_server_packages()
        from ..numerics.freed_memory import keep_freed_memory
        from ..viewing.scene_file import ReadOptions
        from ..viewing.serve import ViewerServer
        from ..viewing.session import Session

        # Before the threads that draw start.
        keep_freed_memory()
        subjects = open_subjects(files, ReadOptions(dialect, assets, frame, opacity))
        with ViewerServer(Session(subjects), port or 0) as server:
            try:
                with shown_address(server.url, browser):
                    server.wait()
            except KeyboardInterrupt:
                # The usual end of a viewer. A picture that is being drawn is finished first.
                console.print("closing")
        console.print("closed")


def open_subjects(paths: Sequence[Path], read_options: "ReadOptions") -> list["Subject"]:
    """Open each path as a subject, which is something that the viewer can show.

    - `paths`: files, names of bundled scenes, or `-` for an SVG file on standard input.
    - `read_options`: how SVG files are read. Bundled scenes are read in the dialect in which they
      are written, whatever these options say.
    """
    from ..viewing.open_files import open_files

    others = [path for path in paths if not scenes.is_bundled(path) and path != STANDARD_INPUT]
    files = iter(open_files(others, read_options))
    subjects = []
    for path in paths:
        if scenes.is_bundled(path):
            subjects.append(bundled_subject(str(path), read_options))
        elif path == STANDARD_INPUT:
            subjects.append(_read_standard_input(read_options))
        else:
            subjects.append(next(files))
    return subjects


def _read_standard_input(read_options: "ReadOptions") -> "Subject":
    """Read an SVG file from standard input, as a subject that the viewer can show.

    Raises `ValueError` for a file that cannot be read or declares no size.
    """
    from ..io.svg.xml.document import MAX_BYTES
    from ..viewing.scene_file import SceneFile

    text = sys.stdin.buffer.read(MAX_BYTES + 1)
    subject = SceneFile(STANDARD_INPUT, read_options, text)
    # Unlike a file it will not change, so that an error is better raised before a page opens.
    subject.size()
    return subject


def bundled_subject(name: str, read_options: "ReadOptions") -> "Subject":
    """Open the bundled scene `name` as a subject, which the viewer can show.

    A scene with an SVG file is read as `read_options` say, but in the dialect in which it is
    written. `read_options` have no effect on a scene that a Python function makes.
    """
    from ..viewing.scene_file import SceneFile
    from ..viewing.scene_in_memory import SceneInMemory

    if not scenes.is_scripted(name):
        return SceneFile(scenes.path(name), replace(read_options, dialect=scenes.dialect(name)))
    source = f"from softras2d import scenes\n\nscene = scenes.read({name!r})\n"
    return SceneInMemory(name, scenes.read(name), scenes.SIZE, scenes.SIZE, source=source)


@contextmanager
def shown_address(url: str, browser: bool) -> Iterator[None]:
    """Print the address of the viewer's page, and open it in the browser if `browser` is true.

    The temporary file by which the browser finds the page exists until the `with` block ends.
    """
    from ..viewing.browser import opened_page

    Console(soft_wrap=True, highlight=False).print(f"viewer: {url}", markup=False)
    with opened_page(url) if browser else nullcontext():
        yield


def check_server_packages() -> None:
    """Raise `ValueError`, with a message of one line, if packages of the server are missing."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ModuleNotFoundError as missing:
        raise ValueError(
            f'the viewer needs more packages: pip install "softras2d[view]" ({missing}).'
        ) from None
