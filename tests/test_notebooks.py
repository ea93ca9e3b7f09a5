"""Notebooks use names that the package has. CI also runs them, which takes minutes."""

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

import softras2d as sr

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


def code_of(path: Path) -> str:
    """The code of all cells of a notebook."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def missing_names(code: str) -> Iterator[str]:
    """Names that the code takes from the package and that do not exist there."""
    known: dict[str, object] = {"sr": sr}
    nodes = list(ast.walk(ast.parse(code)))
    for node in nodes:
        match node:
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] == "softras2d":
                for alias in node.names:
                    # Run the import itself, since `from` also finds modules not yet imported.
                    try:
                        exec(f"from {module} import {alias.name}", known)
                    except ImportError:
                        yield f"{module}.{alias.name}"
    for node in nodes:
        match node:
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if name in known:
                if not hasattr(known[name], attribute):
                    yield f"{name}.{attribute}"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_names_in_a_notebook_exist(path: Path) -> None:
    code = code_of(path)
    assert "import softras2d as sr" in code
    assert list(missing_names(code)) == []


def test_missing_names_are_found() -> None:
    code = "from softras2d import plot\nfrom softras2d.options import gone\nplot.missing(sr.absent)"
    assert set(missing_names(code)) == {"softras2d.options.gone", "plot.missing", "sr.absent"}
