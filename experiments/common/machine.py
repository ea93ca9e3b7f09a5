"""Describe the machine and the versions with which an experiment ran."""

import os
import platform
import re
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any


def record(packages: Iterable[str]) -> dict[str, Any]:
    """Machine, cores, memory, load, Python and the versions of `packages` (None: not installed)."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "memory_gib": _memory_gib(),
        "load_average_1min": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "packages": {name: version(name) for name in packages},
    }


def describe(run: dict[str, Any], *, seed: str) -> str:
    """A run's machine, packages, precision and `seed` in one line, without a full stop."""
    on = run["machine"]
    packages = ", ".join(f"{name} {got}" for name, got in on["packages"].items() if got)
    return (
        f"{on['date']}: {on['processor']}, {on['cores']} cores, {on['memory_gib']} GiB, "
        f"{on['system'].split('-')[0]}, Python {on['python']}; {packages}; {seed}, "
        f"{run['precision']}"
    )


def version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    """Model, family and vector width of the first processor; cloud machines tell little else."""
    path = Path("/proc/cpuinfo")
    if not path.exists():
        return platform.processor() or platform.machine()
    fields = dict(re.findall(r"^([\w ]+?)\s*:[ \t]*(.*)$", path.read_text(), re.MULTILINE))
    flags = fields.get("flags", "").split()
    vectors = next((name for name in ("avx512f", "avx2", "avx") if name in flags), "no avx")
    return (
        f"{fields.get('model name', platform.machine())}, family {fields.get('cpu family', '?')}, "
        f"model {fields.get('model', '?')}, {vectors}"
    )


def _memory_gib() -> float | None:
    if not hasattr(os, "sysconf"):
        return None
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
