"""The README's Python blocks run as one session, and its commands and images exist."""

import re
from pathlib import Path

import jax
import pytest
from typer.testing import CliRunner

from softras2d.cli import app

README = (Path(__file__).parent.parent / "README.md").read_text()


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_python_blocks_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    blocks = _blocks("python")
    assert len(blocks) >= 4
    # Users run these blocks with JAX's default promotion, which optax needs and other tests forbid.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        for block in blocks:
            exec(compile(block, "README.md", "exec"), names)
    assert names["images"].shape == (2, 90, 100, 3)
    assert names["pixels"].shape == (90, 100, 3)


@pytest.mark.parametrize(
    "line",
    [
        line
        for block in _blocks("sh")
        for line in block.splitlines()
        if line.startswith("softras2d ")
    ],
)
def test_shell_lines_name_options_that_exist(line):
    words = line.split()
    result = CliRunner().invoke(app, [words[1], "--help"])
    assert result.exit_code == 0
    for word in words:
        if word.startswith("--"):
            assert word in result.output


def test_pictures_exist():
    root = Path(__file__).parent.parent
    for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README):
        assert (root / path).is_file(), path
