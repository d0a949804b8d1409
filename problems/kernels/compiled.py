"""How kernels are compiled: flags, and a cache that knows when a source has changed.

numba's own cache looks at one file only, so that an edit in another kernel would go unnoticed.  The
cache folder is therefore named by a hash of all kernel sources that may call each other and of the
flags.  The first call on a machine compiles for up to two minutes, and says so; its results are
those of later ones, bit for bit (`OwnCopies`).
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from llvmlite.binding import Linkage
from numba.core import cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.errors import NumbaExperimentalFeatureWarning
from numba.core.imputils import impl_ret_borrowed
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from problems.kernels.sources import defining, sources

FAST_MATH = frozenset({"reassoc", "contract", "nsz"})
"""Sums may be regrouped for vector instructions; NaN and infinity keep their meaning."""


class OwnCopies(JITCodeLibrary):
    """Machine code that calls its own copies of the kernels that it calls.

    numba links these copies weakly.  Each has been optimized where it stands and rounds in its own
    way, and which one runs would depend on what was loaded first: a run that compiles and the next
    one, from the cache, would differ in the last bits.
    """

    def _finalize_final_module(self) -> None:
        self._finalized = True  # as it is, but for the linkage: what callers link in stays weak
        self._get_module_for_linking()
        self._finalized = False
        for function in self._final_module.functions:
            if function.linkage is Linkage.linkonce_odr and not function.is_declaration:
                function.linkage = Linkage.internal
        super()._finalize_final_module()


type(cpu_target.target_context.codegen())._library_class = OwnCopies


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
        print("glambda: compiling kernels, once, up to two minutes …", file=sys.stderr)
    return folder


@contextmanager
def _cached_in(folder: str) -> Iterator[dict[str, Any]]:
    """Options for a decorator of numba, while its cache is in `folder`."""
    elsewhere = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
    try:
        yield {"cache": True, "error_model": "numpy", "fastmath": set(FAST_MATH)}
    finally:
        numba.config.CACHE_DIR = elsewhere  # type: ignore[attr-defined]


def kernel_decorator(sources: Sequence[Path]) -> Callable[[Any], Any]:
    """Decorator that compiles a function of one of `sources`; it stays callable from the others."""
    folder = str(cache_folder(sources))

    def kernel(function: Any) -> Any:
        with _cached_in(folder) as options:
            return numba.njit(**options)(function)

    return kernel


def function_decorator(sources: Sequence[Path], signature: Any) -> Callable[[Any], Any]:
    """Decorator that compiles a function of one signature, which kernels can be handed."""
    folder = str(cache_folder(sources))

    def function(python_function: Any) -> Any:
        with _cached_in(folder) as options:
            return numba.cfunc(signature, **options)(python_function)

    return function


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        members: Any = kind
        parts = [
            _without_owner(context, builder, members[i], part)
            for i, part in enumerate(cgutils.unpack_tuple(builder, value))
        ]
        return context.make_tuple(builder, kind, parts)
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()
    return value


def _lend(typingctx: Any, arrays: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, signature.args[0], arguments[0])

    return arrays(arrays), codegen


lent: Any = intrinsic(_lend)
"""`lent(x)` in a kernel: its argument x, array or tuple of these, whose holders are not counted.

Each time that compiled code takes an array out of a tuple or hands it on, it counts, atomically,
who holds it: up to three quarters of the time of a step.  The caller holds the arguments of a
kernel for as long as it runs.  What is lent must not be returned.
"""


def _keep_from_writing(typingctx: Any, array: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return impl_ret_borrowed(context, builder, signature.return_type, arguments[0])

    return array.copy(readonly=True)(array), codegen


read_only: Any = intrinsic(_keep_from_writing)
"""`read_only(x)` in a kernel: the same array, not to be written to, as a solver wants a QP."""


def _in_rows(typingctx: Any, array: Any, rows: Any, columns: Any) -> Any:
    kind = array.copy(ndim=2)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = context.make_array(array)(context, builder, arguments[0])
        matrix = context.make_array(kind)(context, builder)
        width = vector.itemsize
        shape = [
            context.cast(builder, count, given, types.intp)
            for count, given in zip(arguments[1:], (rows, columns), strict=True)
        ]
        populate_array(
            matrix,
            data=vector.data,
            shape=shape,
            strides=[builder.mul(shape[1], width), width],
            itemsize=width,
            meminfo=vector.meminfo,
        )
        return impl_ret_borrowed(context, builder, kind, matrix._getvalue())

    return kind(array, rows, columns), codegen


in_rows: Any = intrinsic(_in_rows)
"""`in_rows(x, n, m)` in a kernel: x (n m,) as (n, m), in no time."""


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
            with warnings.catch_warnings():
                # functions as arguments are "experimental"; what is used of them is tested
                warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
                self.kernel.compile(signature)
            self._code = self.kernel.overloads[signature].entry_point
        return self._code(*arguments)


kernel = kernel_decorator(sources(defining(Path(__file__).parents[1], "\n@kernel\n"), ["problems"]))
