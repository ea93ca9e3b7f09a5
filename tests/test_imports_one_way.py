"""Imports go one way, and there are no unexpected files at the top of a folder.

Within the package, a module imports only from folders before its own in `ORDER`. `experiments` may
import from `tests`, but `tests` may not import from `experiments`, apart from a few.
"""

import ast
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "softras2d"

ORDER = (
    "names",
    "options",
    "color",
    "numerics",
    "display",
    "geometry",
    "texture",
    "scene",
    "binning",
    "coverage",
    "shading",
    "compositing",
    "gradients",
    "planning",
    "rendering",
    "camera",
    "io",
    "tiled",
    "comparison",
    "fitting",
    "viewing",
    "plot",
    "testing",
    "scenes",
    "pictures",
    "cli",
    "__main__",
)
"""Files and folders at the top of the package. Each imports from itself and those before it."""

ORDER_IN_SVG = (
    "xml",
    "values",
    "css",
    "canvas",
    "elements",
    "painting",
    "reading",
    "writing",
)
"""Folders of `io/svg`. Each imports from itself and those before it."""

FOLDERS = {"softras2d", "tests", "notebooks", "experiments"}
TOP_LEVEL = FOLDERS | {"pyproject.toml", "README.md", "LICENSE"}

GENERATED = {"build", "dist", "__pycache__", "demo"}
"""Folders that a build, a run or the README's first command creates."""


def module_of(file: Path) -> str:
    """The dotted name of the module in a file of the package."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def imports(module: str, file: Path, source: str) -> Iterator[str]:
    """The modules of the package that a module imports anywhere, even in functions or for types."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name in FILES)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(above if node.level else []), *filter(None, [node.module])])
            for name in node.names:
                full = f"{base}.{name.name}"
                if full in FILES or base in FILES:
                    yield full if full in FILES else base


GRAPH = {
    module: set(imports(module, file, file.read_text(encoding="utf-8")))
    for module, file in FILES.items()
    if module != "softras2d"
}
"""What each module imports. The package's own file, which loads all others lazily, is left out."""


def top_level_name(module: str) -> str:
    """The name at the top of the package under which a module lies, as in `ORDER`."""
    return module.split(".")[1]


def test_imports_anywhere_in_a_file_are_recognized():
    source = "def f():\n from . import info\n from ..io.images import read_image as r\nimport jax"
    imported = list(imports("softras2d.cli.made_up", Path("made_up.py"), source))
    assert imported == ["softras2d.cli.info", "softras2d.io.images"]
    imported = list(
        imports("softras2d.camera", Path("__init__.py"), "from .near_plane import clip")
    )
    assert imported == ["softras2d.camera.near_plane"]
    assert "softras2d.scene" in GRAPH["softras2d.plot.overlay"]


def test_every_top_level_name_has_a_rank():
    assert {top_level_name(module) for module in GRAPH} <= set(ORDER)


def test_imports_go_one_way():
    rank = {name: number for number, name in enumerate(ORDER)}
    wrong = [
        f"{module} imports {other}"
        for module, others in GRAPH.items()
        for other in sorted(others - {"softras2d"})
        if rank[top_level_name(other)] > rank[top_level_name(module)]
    ]
    assert not wrong


SVG = "softras2d.io.svg"


def folder_in_svg(module: str) -> str:
    """The folder of `io/svg` in which a module of it lies, as in `ORDER_IN_SVG`."""
    return module.removeprefix(f"{SVG}.").split(".")[0]


def test_every_module_of_svg_lies_in_a_folder_with_a_rank():
    modules = {module for module in GRAPH if module.startswith(f"{SVG}.")}
    assert {folder_in_svg(module) for module in modules} == set(ORDER_IN_SVG)
    assert [file.name for file in (PACKAGE / "io" / "svg").glob("*.py")] == ["__init__.py"]


def test_imports_in_svg_go_one_way():
    rank = {name: number for number, name in enumerate(ORDER_IN_SVG)}
    wrong = [
        f"{module} imports {other}"
        for module, others in GRAPH.items()
        for other in sorted(others)
        if module.startswith(f"{SVG}.") and other.startswith(f"{SVG}.")
        if rank[folder_in_svg(other)] > rank[folder_in_svg(module)]
    ]
    assert not wrong


def test_the_docstring_of_svg_lists_its_folders_in_order():
    docstring = ast.get_docstring(ast.parse(FILES[SVG].read_text(encoding="utf-8")))
    assert tuple(re.findall(r"^- `(\w+)`:", docstring or "", re.MULTILINE)) == ORDER_IN_SVG


def test_no_modules_import_each_other_in_a_circle():
    try:
        TopologicalSorter(GRAPH).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


TESTS_OF_EXPERIMENTS = {
    # The script of the bundled scenes must still write the files that the package contains.
    "scenes/test_scenes.py",
    # The script of the bundled pictures must still make those that the package contains.
    "test_pictures.py",
}
"""Tests that may import `experiments`: each runs a script through its public entry point."""


def test_tests_do_not_import_experiments():
    importing = set()
    for file in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
                names += [name.name for name in node.names] if node.level else []
            if any(name.split(".")[0] == "experiments" for name in names):
                importing.add(file.relative_to(ROOT / "tests").as_posix())
    assert importing == TESTS_OF_EXPERIMENTS


def test_few_files_at_the_top_of_the_package():
    assert len(list(PACKAGE.glob("*.py"))) <= 6


def test_the_top_of_the_repository_holds_only_what_it_should():
    names = {
        path.name for path in ROOT.iterdir() if not path.name.endswith(".egg-info")
    } - GENERATED
    if shutil.which("git") and (ROOT / ".git").exists():
        command = ["git", "-C", str(ROOT), "ls-files"]
        listed = subprocess.run(command, capture_output=True, text=True, check=False)
        if listed.returncode == 0:
            names = {path.split("/")[0] for path in listed.stdout.splitlines()}
    assert {name for name in names if not name.startswith(".")} <= TOP_LEVEL


def test_types_are_checked_in_every_package_but_those_of_text():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]
    (option,) = (
        word.removeprefix("--jaxtyping-packages=")
        for word in settings["ini_options"]["addopts"]
        if word.startswith("--jaxtyping-packages=")
    )
    *checked, checker = option.split(",")
    assert checker == "beartype.beartype"
    of_text = {"io", "cli", "__main__"}
    expected = {f"softras2d.{name}" for name in ORDER if name not in of_text}
    assert set(checked) == expected | {"softras2d.io.shapes"}
