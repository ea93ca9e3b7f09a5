"""Sets up JAX's persistent compilation cache in the user's cache folder."""

import hashlib
import os
import platform
import sys
from pathlib import Path

_MAX_BYTES = 512 * 2**20
"""Size of the cache, in bytes, above which `keep_compiled_programs` deletes its oldest programs.

JAX itself bounds the size only if `filelock` is installed.
"""

_CPU_INFO = Path("/proc/cpuinfo")
"""File in which Linux describes the processor; other systems lack it."""


def keep_compiled_programs() -> None:
    """Make JAX keep compiled programs on disk, so that the next process loads them.

    Call it before the first render; the command line does so by itself. The programs are kept in
    `cache_folder()`, which is created if it does not exist. If it holds more than 512 MiB, its
    oldest programs are deleted first. If the folder cannot be created or written to, no programs
    are kept. Where JAX has a cache folder already (set by `JAX_COMPILATION_CACHE_DIR`, for
    instance), this function does nothing. Several processes may share the cache: JAX compiles again
    if it cannot read an entry.

    JAX keeps no program that calls the host, and a program that raises an error on overflow
    (`plan(..., on_overflow="raise")`) does so. Programs with `on_overflow="nan"` or
    `capacity="worst_case"` are kept.

    **Source:** docs.jax.dev, *Persistent compilation cache*.
    """
    import jax

    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return
    try:
        folder = cache_folder()
        # JAX runs the programs in this folder, so nobody else may write to it.
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _trim(folder)
    except (OSError, RuntimeError):
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # By default JAX keeps only programs that took a second to compile; most of ours take less.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path:
    """Path of the folder in which compiled programs are kept.

    It lies in the user's cache folder, and is for this type of processor only. It is not created
    here. If `XDG_CACHE_HOME` is an absolute path, it is the user's cache folder on every system.
    Raises `RuntimeError` if the path depends on the home folder and there is none.
    """
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    # Relative paths are to be ignored (XDG Base Directory Specification).
    if os.path.isabs(chosen):
        base = Path(chosen)
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path.home() / ".cache"
    return base / "softras2d" / "xla" / _processor()


def _processor() -> str:
    """A name that identifies the instruction set of this processor.

    XLA compiles for the processor it runs on, and JAX's cache key does not include its type.
    Without this name, machines that share a home folder would load each other's programs.
    """
    try:
        lines = _CPU_INFO.read_text().splitlines()
    except OSError:
        lines = []
    lines = lines or [platform.processor()]
    known = next((line for line in lines if line.startswith(("flags", "Features"))), lines[0])
    return f"{platform.machine()}-{hashlib.sha256(known.encode()).hexdigest()[:8]}"


def _trim(folder: Path) -> None:
    """If the cache in `folder` exceeds `_MAX_BYTES`, delete its oldest programs.

    Programs are deleted until the rest takes at most half of `_MAX_BYTES`.
    """
    entries = [(entry.stat(), entry) for entry in os.scandir(folder) if entry.is_file()]
    size = sum(status.st_size for status, _ in entries)
    if size <= _MAX_BYTES:
        return
    for status, entry in sorted(entries, key=lambda pair: pair[0].st_mtime):
        # Another process may have deleted it already.
        Path(entry).unlink(missing_ok=True)
        size -= status.st_size
        if size <= _MAX_BYTES // 2:
            return
