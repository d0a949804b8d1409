"""How the method's kernels are compiled: as those of `problems.compiled`, which they may call.

The first call on a machine compiles for up to two minutes, and says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba

from problems import compiled

SOURCES = (
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
    "sparse_direction.py",
    "sparse_loop.py",
    "minimum_norm.py",
    "passes.py",
    "quiet_steps.py",
)
PHYSICS = (
    *("compiled.py", "qp.py", "quiet.py", "multistep.py", "minimum_norm.py"),
    *("sparse_minimum_norm.py", *compiled.SOURCES),
)
"""Files of `problems` whose functions or constants are compiled into kernels."""

kernel = compiled.kernel_decorator(
    [
        Path(__file__),
        *(Path(__file__).with_name(name) for name in SOURCES),
        *(Path(compiled.__file__).with_name(name) for name in PHYSICS),
    ]
)

in_rows, lent, read_only = compiled.in_rows, compiled.lent, compiled.read_only


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


class Direct:
    """`kernel` as a callable that looks at the types of its arguments at the first call only.

    For arguments of the same types at every call, whatever happens: nothing else is checked.
    """

    def __init__(self, kernel: Any):
        self.kernel = kernel
        self._code: Any = None

    def __call__(self, *arguments: Any) -> Any:
        if self._code is None:
            signature = tuple(numba.typeof(argument) for argument in arguments)
            self.kernel.compile(signature)
            self._code = self.kernel.overloads[signature].entry_point
        return self._code(*arguments)
