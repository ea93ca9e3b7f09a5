"""The command line: `softras2d render`, `view`, `fit`, `fit-batch`, `compare`, `info`, `demo`.

Each command is in a separate file. Heavy packages (JAX, OpenImageIO) are imported when a command
runs, so that `--help` answers at once.
"""

import sys
from typing import Annotated

import typer

from .. import __version__
from .compare import compare_files
from .demo import make_demo
from .fit import fit_picture
from .fit_batch import fit_folder
from .info import describe_scene
from .render import render_scenes
from .view import view_files

app = typer.Typer(
    name="softras2d",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("render")(render_scenes)
app.command("view")(view_files)
app.command("fit")(fit_picture)
app.command("fit-batch")(fit_folder)
app.command("compare")(compare_files)
app.command("info")(describe_scene)
app.command("demo")(make_demo)


def _print_version(wanted: bool) -> bool:
    """Print the version and exit with code 0 if `wanted`, the value of `--version`, is true.

    Otherwise return `wanted`.
    """
    if wanted:
        typer.echo(f"softras2d {__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _about(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Render triangle scenes exactly, and fit triangles to pictures.

    Try it:  [bold]softras2d demo pictures/[/bold]   [bold]softras2d fit[/bold]   [bold]softras2d
    view scene.svg[/bold]

    Compiled programs are kept in your cache folder, so that the next run starts faster.
    Set SOFTRAS2D_DEBUG=1 to see the whole traceback of an error.
    """


def main() -> None:
    """Run the command line, and exit with a code.

    The code is 0 after success, 1 after an error, 2 for wrong usage, and 130 after Ctrl-C.
    `compare` exits like `diff`: with 1 if the images differ, and with 2 after an error that is
    printed on one line (`session`).
    """
    try:
        app()
    except KeyboardInterrupt:
        # Interrupted before or after a command; within one, its session prints a line.
        sys.exit(130)
