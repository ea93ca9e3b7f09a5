"""`softras2d --help` imports neither JAX nor other heavy modules, as a separate process shows."""

import subprocess
import sys

import pytest

HEAVY = (
    "jax",
    "jaxlib",
    "equinox",
    "numpy",
    "OpenImageIO",
    "matplotlib",
    "starlette",
    "uvicorn",
    "websockets",
    "anywidget",
)


def heavy_modules(code: str) -> set[str]:
    """The heavy modules that a fresh Python has imported after running `code`."""
    script = f"""
import sys
try:
    {code}
except SystemExit as stop:
    assert not stop.code, stop.code
print("\\n" + " ".join(name for name in {HEAVY!r} if name in sys.modules))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


def test_importing_the_package_imports_nothing_heavy():
    assert heavy_modules("import softras2d; softras2d.__version__, dir(softras2d)") == set()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["render", "--help"],
        ["compare", "-h"],
        ["info", "-h"],
        ["demo", "-h"],
        ["view", "-h"],
        ["fit", "-h"],
    ],
)
def test_help_imports_nothing_heavy(arguments):
    code = f"sys.argv[1:] = {arguments!r}; from softras2d.cli import main; main()"
    assert heavy_modules(code) == set()


def test_a_name_of_the_package_is_loaded_on_first_use():
    assert "jax" in heavy_modules("import softras2d; softras2d.Hard")
