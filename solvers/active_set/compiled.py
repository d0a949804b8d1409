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
    "settled.py",
    "loop.py",
    "sparse_pattern.py",
    "sparse_workspace.py",
    "sparse_cholesky.py",
    "sparse_loop.py",
    "quiet_steps.py",
    "../../problems/quiet.py",
    "../../problems/contact_kernels.py",
    "../../problems/dips.py",
    "../../problems/step_kernels.py",
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


def entry(kernel: Any, *arguments: str) -> Any:
    """The machine code of `kernel` for arguments of these types, as a callable that checks nothing.

    arguments : "matrix", "vector", "indices" : read-only float64 (2), float64 (1), int64 (1);
        "floats", "ints" : float64 (2) and int64 (2) to be written to; "float", "int".  In C order.

    numba's dispatcher looks at the type of every argument at every call, which takes as long as
    handing them over does; what types these are is known here.
    """
    real, whole = numba.float64, numba.int64
    types = {
        "matrix": numba.types.Array(real, 2, "C", readonly=True),
        "vector": numba.types.Array(real, 1, "C", readonly=True),
        "indices": numba.types.Array(whole, 1, "C", readonly=True),
        "floats": numba.types.Array(real, 2, "C"),
        "ints": numba.types.Array(whole, 2, "C"),
        "float": real,
        "int": whole,
    }
    signature = tuple(types[name] for name in arguments)
    kernel.compile(signature)
    return kernel.overloads[signature].entry_point
