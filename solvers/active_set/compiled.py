"""How the method's kernels are compiled: as those of `problems.kernels.compiled`, which they may
call.

The first call on a machine compiles for up to two minutes, and says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba

from problems.kernels import compiled
from problems.kernels.sources import defining, sources
from problems.qp_kernel import SIGNATURE

MARKS = "\n@kernel\n", "\n@function\n"
SOURCES = sources(
    (file for mark in MARKS for file in defining(Path(__file__).parent, mark)),
    ["problems", "solvers"],
)
"""Files whose functions or constants are compiled into the method's kernels."""

kernel = compiled.kernel_decorator(SOURCES)
stage = compiled.kernel_decorator(SOURCES, inline="always")
"""A kernel that is compiled into those that call it, and nowhere else: a part of one other, or so
small that to be handed its arrays takes longer than what it does (b_cᵀx: 12 ns called, 2.5 not)."""
function = compiled.function_decorator(SOURCES, SIGNATURE)


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
