"""Files are replaced completely or not at all, and drafts of killed processes are removed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from softras2d.io.drafts import atomic_file

KILLED = """
import os, pathlib, signal, sys
from softras2d.io.drafts import atomic_file
with atomic_file(pathlib.Path(sys.argv[1])) as draft:
    draft.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def abandon(path: Path) -> Path:
    """Leave a draft of `path`, as a process that is killed while writing does."""
    before = set(path.parent.iterdir())
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    (draft,) = set(path.parent.iterdir()) - before
    return draft


def write(path: Path, text: str = "whole") -> None:
    with atomic_file(path) as draft:
        draft.write_text(text)


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX processes")
class TestAbandonedDrafts:
    def test_the_next_write_to_the_same_name_removes_them(self, tmp_path):
        path = tmp_path / "a [1]*.txt"
        abandon(path)
        abandon(path)
        write(path)
        assert [entry.name for entry in tmp_path.iterdir()] == [path.name]

    def test_drafts_of_other_names_are_left(self, tmp_path):
        drafts = {abandon(tmp_path / name) for name in ("b.txt", "a.png", "a-b.txt", "A.txt")}
        write(tmp_path / "a.txt")
        assert set(tmp_path.iterdir()) == drafts | {tmp_path / "a.txt"}

    def test_drafts_that_are_being_written_are_left(self, tmp_path):
        path = tmp_path / "a.txt"
        with atomic_file(path) as first:
            first.write_text("first")
            write(path, "second")
            assert first.exists()
        assert path.read_text() == "first"
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("stem", ["a" * 250, "é" * 120, "🎨" * 60])
def test_names_may_be_as_long_as_the_file_system_allows(tmp_path, stem):
    path = tmp_path / f"{stem}.png"
    write(path)
    assert path.read_text() == "whole"


@pytest.mark.parametrize("kind", [ValueError, OSError])
def test_errors_name_the_file_and_not_its_draft(tmp_path, kind):
    path = tmp_path / "a.txt"
    with pytest.raises(ValueError) as caught, atomic_file(path) as draft:
        raise kind(f"{draft}: the library says\nthat {draft.name} is bad")
    message = str(caught.value)
    assert str(path) in message and draft.name not in message and "\n" not in message
    assert list(tmp_path.iterdir()) == []


def test_an_old_file_is_left_if_the_new_one_fails(tmp_path):
    path = tmp_path / "a.txt"
    write(path, "old")
    with pytest.raises(ZeroDivisionError), atomic_file(path) as draft:
        draft.write_text("new")
        raise ZeroDivisionError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
