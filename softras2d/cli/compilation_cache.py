"""JAX's persistent compilation cache, in the user's cache folder."""

import hashlib
import os
import platform
import sys
from pathlib import Path

_LARGEST = 512 * 2**20
"""Bytes. JAX itself only bounds the cache with the help of another package (`filelock`)."""


def keep_compiled_programs() -> None:
    """Let JAX keep every compiled program on disk; where it cannot write, go on without.

    A folder that the user chose (`JAX_COMPILATION_CACHE_DIR`) stays. Several processes may share
    it: JAX answers an entry that it cannot read by compiling.

    **Source:** docs.jax.dev, *Persistent compilation cache*.
    """
    import jax

    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return
    try:
        folder = cache_folder()
        # JAX runs what it finds there, so nobody else may write.
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _trim(folder)
    except (OSError, RuntimeError):
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # By default only programs that took a second to compile are kept. Ours take less, each.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path:
    """Where the user's system keeps what can be computed again, and a folder for this processor.

    `XDG_CACHE_HOME` is honoured everywhere. Raises `RuntimeError` if there is no home.
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
    """A name for the instructions that this processor has.

    XLA compiles for those of the machine it runs on, and JAX's key does not hold them: a home
    shared by two machines would hand one the other's programs.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.processor()]
    known = next((line for line in lines if line.startswith(("flags", "Features"))), lines[0])
    return f"{platform.machine()}-{hashlib.sha256(known.encode()).hexdigest()[:8]}"


def _trim(folder: Path) -> None:
    """Beyond the largest size, delete the oldest programs until half of it is left."""
    entries = [(entry.stat(), entry) for entry in os.scandir(folder) if entry.is_file()]
    size = sum(facts.st_size for facts, _ in entries)
    if size <= _LARGEST:
        return
    for facts, entry in sorted(entries, key=lambda pair: pair[0].st_mtime):
        # Another process may have been faster.
        Path(entry).unlink(missing_ok=True)
        size -= facts.st_size
        if size <= _LARGEST // 2:
            return
