"""How the kernels are compiled: flags, and a cache that knows when a source has changed.

numba's own cache looks at one file only, so that an edit in another kernel would go unnoticed.
The cache folder is therefore named by a hash of all kernel sources and of the flags; it is chosen
before any kernel is decorated.  The first call on a machine compiles for some seconds, and says so.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

SOURCES = (
    "compiled.py",
    "workspace.py",
    "factorization.py",
    "conjugate_gradients.py",
    "flops.py",
    "online_rule.py",
    "loop.py",
    "sparse_pattern.py",
    "sparse_workspace.py",
    "sparse_cholesky.py",
    "sparse_loop.py",
)
FAST_MATH = frozenset({"reassoc", "contract", "nsz"})
"""Sums may be regrouped for vector instructions; NaN and infinity keep their meaning."""


def _cache_folder() -> Path:
    here, key = Path(__file__).parent, hashlib.sha256()
    for name in SOURCES:
        key.update((here / name).read_bytes())
    key.update(os.environ.get("NUMBA_BOUNDSCHECK", "").encode())
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(home) / "glambda" / f"kernels-{key.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"glambda-kernels-{key.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def _announce(folder: Path) -> None:
    if not any(folder.iterdir()):
        print("glambda: compiling the kernels, once, some ten seconds …", file=sys.stderr)


_folder = _cache_folder()
_announce(_folder)

import numba  # noqa: E402

numba.config.CACHE_DIR = str(_folder)  # type: ignore[attr-defined]


def kernel(function: Any) -> Any:
    """Compile a function to machine code; it stays callable from other kernels."""
    return numba.njit(cache=True, error_model="numpy", fastmath=set(FAST_MATH))(function)
