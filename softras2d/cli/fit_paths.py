"""Checks the files that `softras2d fit` reads and writes, before JAX is loaded."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from .. import names
from ..comparison.chromium import BROWSERS, find_browser
from ..io.outputs import WRITABLE, check_writable_path

STANDARD_STREAM = Path("-")
"""The path `-`, which means standard input or standard output instead of a file."""

BUNDLED = "valley"
"""Name of the bundled picture that is fitted if the user names no picture."""

COMPACT = ".s2d"
"""Suffix of compact binary files of scenes."""

SUFFIXES = (".svg", *WRITABLE, ".gif", ".npz", COMPACT, ".json")
"""Suffixes of the files that the command writes."""


def find_suffix(paths: Sequence[Path], suffix: str) -> Path | None:
    """The first path with this suffix, whether in upper or lower case; None if there is none.

    `suffix` is in lower case, with its dot.
    """
    return next((path for path in paths if path.suffix.lower() == suffix), None)


def check_input(path: Path | None) -> None:
    """Raise `ValueError` unless `path` is an existing file, `-` (standard input) or None."""
    if path is None or path == STANDARD_STREAM or path.is_file():
        return
    if path.is_dir():
        raise ValueError(
            f"{path}: a folder; fit every picture in it with: softras2d fit-batch {path} -o OUT"
        )
    raise ValueError(f"{path}: no such file.")


def check_outputs(paths: Sequence[Path], inputs: dict[Path, str]) -> None:
    """Raise `ValueError` if one of the output files `paths` cannot be written, or is given twice.

    A file cannot be written if its suffix, in lower case, is not in `SUFFIXES`, if it is a folder,
    if its folder is missing or may not be written to, or if it is one of `inputs`. `-` is standard
    output, which can always be written. Two outputs are the same if they are spelled alike.

    `inputs`: files that must not be overwritten; each has its role as a text for the message. An
    entry at whose path there is no file is ignored.
    """
    for path in paths:
        if path == STANDARD_STREAM:
            continue
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f"{path}: the suffix must be one of {', '.join(SUFFIXES)}.")
        check_writable_path(path)
        if not os.access(path.parent, os.W_OK):
            raise ValueError(f"{path}: the folder {path.parent} cannot be written to.")
        for input_path, role in inputs.items():
            if path.exists() and input_path.exists() and path.samefile(input_path):
                raise ValueError(f"{path}: that is {role}.")
    if len(set(paths)) < len(paths):
        raise ValueError("the same --output is given twice.")


def check_digits(digits: int | None, paths: Sequence[Path]) -> None:
    """Raise `ValueError` if `--digits` is given, but none of the output files is an SVG.

    `digits` is the value of the option, or None; `paths` are the output files, of which `-` is an
    SVG.
    """
    if digits is not None:
        _check_svg("--digits", paths)


def check_compare_in(name: str | None, paths: Sequence[Path]) -> None:
    """Raise `ValueError` if `--compare-in` is given without an SVG to write or a browser to use.

    - `name`: the value of the option, a command or a path; None if it is not given.
    - `paths`: the output files, of which `-` is an SVG.
    """
    if name is None:
        return
    _check_svg("--compare-in", paths)
    if find_browser(name) is None:
        wanted = (
            f"none of {', '.join(BROWSERS)} is installed" if name == BROWSERS[0]
            else "no such command or program"
        )  # fmt: skip
        raise ValueError(f"--compare-in {name}: {wanted}.")


def _check_svg(option: str, paths: Sequence[Path]) -> None:
    """Raise `ValueError` unless one of the output files is an SVG, or `-`, which stands for one.

    `option`: the option that needs an SVG, for the message.
    """
    if STANDARD_STREAM not in paths and find_suffix(paths, ".svg") is None:
        names_of_files = ", ".join(map(str, paths))
        raise ValueError(f"{option} is for SVG files; got no SVG to write, but {names_of_files}.")


def check_start(text: str, family: str) -> None:
    """Raise `ValueError` unless `text`, the value of `--start`, is a known name or kind of file.

    Fits of either family can start from an `.npz` file, and fits of layers also from an `.svg`
    file. Whether the file exists is not checked.
    """
    starts = get_args(names.FitStart)
    suffix = Path(text).suffix.lower()
    if text in starts or suffix == ".npz" or (suffix == ".svg" and family == "layers"):
        return
    known = "an .npz" if family == "mesh" else "an .svg or .npz"
    raise ValueError(f"--start must be one of {', '.join(starts)}, or {known}; got {text!r}.")


def check_animation(path: Path) -> None:
    """Raise `ValueError` unless `path` has the suffix .svg or .gif, and a folder that exists.

    The suffix may be in upper case. A path that is a folder itself is refused, too.
    """
    if path.suffix.lower() not in (".svg", ".gif"):
        raise ValueError(f"{path}: the suffix of an animation must be .svg or .gif.")
    check_writable_path(path)
