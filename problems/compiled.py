"""How kernels are compiled: flags, and a cache that knows when a source has changed.

numba's own cache looks at one file only, so that an edit in another kernel would go unnoticed.  The
cache folder is therefore named by a hash of all kernel sources that may call each other and of the
flags.  The first call on a machine compiles for some seconds, and says so.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba

FAST_MATH = frozenset({"reassoc", "contract", "nsz"})
"""Sums may be regrouped for vector instructions; NaN and infinity keep their meaning."""


def cache_folder(sources: Sequence[Path]) -> Path:
    """The folder of the machine code made from `sources`, which is made if it is missing."""
    key = hashlib.sha256()
    for source in sources:
        key.update(source.read_bytes())
    key.update(os.environ.get("NUMBA_BOUNDSCHECK", "").encode())
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(home) / "glambda" / f"kernels-{key.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"glambda-kernels-{key.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.iterdir()):
        print("glambda: compiling kernels, once, some ten seconds …", file=sys.stderr)
    return folder


def kernel_decorator(sources: Sequence[Path]) -> Callable[[Any], Any]:
    """Decorator that compiles a function of one of `sources`; it stays callable from the others."""
    folder = str(cache_folder(sources))

    def kernel(function: Any) -> Any:
        elsewhere = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
        try:
            return numba.njit(cache=True, error_model="numpy", fastmath=set(FAST_MATH))(function)
        finally:
            numba.config.CACHE_DIR = elsewhere  # type: ignore[attr-defined]

    return kernel


SOURCES = (
    "active_kernels.py",
    "contact_kernels.py",
    "broad_phase.py",
    "dips.py",
    "step_kernels.py",
    "friction_kernels.py",
    "independence.py",
    "peeling.py",
)

kernel = kernel_decorator([Path(__file__), *(Path(__file__).with_name(name) for name in SOURCES)])
