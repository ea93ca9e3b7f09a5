"""Writes files completely or not at all: first to a draft, which then replaces the old file."""

import os
import platform
import re
import secrets
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_MAX_STEM_BYTES = 80
"""Maximum number of bytes of a file's name that the name of its draft repeats.

File systems allow 255 bytes for the complete name of a file.
"""


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the path of a draft beside `path`, which replaces `path` at the end of a `with` block.

    The block must create the draft, whose name has the suffix of `path`. If the block raises, the
    draft is removed and an old file at `path` stays as it was. `OSError` becomes a `ValueError` of
    one line that names `path`; no `ValueError` names the draft. On POSIX, old drafts of `path` are
    first removed if they were left behind by processes of this machine that no longer run.
    """
    _remove_abandoned(path)
    draft = path.with_name(f"{_prefix(path)}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield draft
        os.replace(draft, path)
    except OSError as error:
        reason = error.strerror or _without_draft(str(error), draft, path)
        raise ValueError(f"{path}: cannot be written: {reason}.") from error
    except ValueError as error:
        if draft.name not in str(error):
            raise
        raise ValueError(_without_draft(str(error), draft, path)) from error
    finally:
        # An error here would hide the one that is being raised.
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def _prefix(path: Path) -> str:
    """Start of the names of all drafts of `path`; it differs between machines that share a folder.

    The id of the process that writes the draft, a random number and the suffix of `path` follow.
    """
    machine_and_name = f"{platform.node()}\0{path.name}".encode(errors="replace")
    stem = path.stem.encode(errors="replace")[:_MAX_STEM_BYTES].decode(errors="ignore")
    return f".{stem}-{zlib.crc32(machine_and_name):08x}-"


def _remove_abandoned(path: Path) -> None:
    """Remove the drafts of `path` whose processes on this machine no longer run.

    Nothing is done on systems other than POSIX. Files that cannot be removed are left.
    """
    # On other systems, `os.kill` with signal 0 would end the process.
    if os.name != "posix":
        return
    pattern = re.compile(
        re.escape(_prefix(path)) + r"(\d{1,9})-[0-9a-f]{8}" + re.escape(path.suffix)
    )
    # If the folder cannot be listed, the write itself will report why.
    with suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            match = pattern.fullmatch(entry.name)
            if match and not _is_running(int(match[1])):
                with suppress(OSError):
                    os.unlink(entry.path)


def _is_running(process: int) -> bool:
    """Whether a process with this id is running."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        # The process belongs to another user.
        return True
    return True


def _without_draft(message: str, draft: Path, path: Path) -> str:
    """An error message on one line, in which `path` replaces `draft`, both as path and as name."""
    message = message.replace(str(draft), str(path)).replace(draft.name, path.name)
    return " ".join(message.split())
