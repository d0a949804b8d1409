"""Where and with what a result was made: processor, system, versions.  No host names, no paths.

A version is more than the package's: the adapter around it decides what it is asked, so a solver's
version carries a hash of our own source as well.  Results of different versions refuse to mix.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path

from harness.machine.threads import threads_asked_for
from problems.kernels.sources import sources
from solvers.base import Solver
from solvers.registry import distribution_of

LIBRARIES = ("glambda", "numpy", "scipy", "h5py", "pandas", "pyarrow")


@cache
def machine_label() -> str:
    """One line: processor, cores, system, Python, threads."""
    about = machine()
    return (
        f"{about['cpu']}, {about['cores']} cores, {about['system']}, "
        f"Python {about['python']}, threads {about['threads']}"
    )


def machine() -> dict[str, str]:
    """Processor, usable cores, operating system, Python and the thread limit in force."""
    return {
        "cpu": _cpu_model(),
        "cores": str(_usable_cores()),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "threads": threads_asked_for(),
    }


def library_versions() -> dict[str, str]:
    """Versions of the libraries that every result depends on."""
    return {name: metadata.version(name) for name in LIBRARIES}


@cache
def commit() -> str:
    """Commit of the checkout that the code stands in, a + behind it if that was changed since.

    Empty where there is no checkout, or no Git.
    """
    asked = ("git", "describe", "--always", "--dirty=+", "--exclude=*")
    try:
        told = subprocess.run(
            asked, cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=9
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return told.stdout.strip()


def version_of(cls: type[Solver]) -> str:
    """Version of a solver: its package's, and a hash of the source around it."""
    package = distribution_of(cls)
    own = [Path(str(sys.modules[cls.__module__].__file__))]
    hashed = source_hash(sources(own, ["solvers"]))
    return f"{package} {metadata.version(package)} (source {hashed})"


@cache
def problems_version() -> str:
    """Version of the code that poses QPs."""
    import problems

    folder = Path(str(problems.__file__)).parent
    return f"glambda {metadata.version('glambda')} (source {source_hash(folder.rglob('*.py'))})"


def source_hash(files: Iterable[Path]) -> str:
    """First eight hexadecimal digits of the sha256 of some files, in order of their paths."""
    total = hashlib.sha256()
    for file in sorted(files):
        total.update(file.name.encode())
        total.update(file.read_bytes())
    return total.hexdigest()[:8]


def _usable_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _cpu_model() -> str:
    """The processor's name; read here, as py-cpuinfo takes a second for it in every process."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            if line.lower().startswith("model name"):
                return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine() or "unknown processor"
