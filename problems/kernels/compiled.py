"""How kernels are compiled: flags, and a cache that knows when a source has changed.

numba's own cache looks at one file only, so that an edit in another kernel would go unnoticed.  The
cache folder is therefore named by a hash of all kernel sources that may call each other and of the
flags.  The first call on a machine compiles for up to two minutes, and says so; its results are
those of later ones, bit for bit (`numba_internals`).
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event

from problems.kernels.numba_internals import LOST, take_literals_as_numbers
from problems.kernels.sources import defining, sources

FAST_MATH = frozenset({"reassoc", "contract", "nsz"})
"""Sums may be regrouped for vector instructions; NaN and infinity keep their meaning."""


FOLDERS: set[Path] = set()
"""Where machine code is kept."""
HOME = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "glambda"
"""Where these folders are: the user's cache, also in a process that is given one of its own later
(`harness.processes.own_process`) and would compile everything anew."""


def cache_folder(sources: Sequence[Path]) -> Path:
    """The folder of the machine code made from `sources`, which is made if it is missing."""
    key = hashlib.sha256()
    for source in sources:
        key.update(source.read_bytes())
    key.update(os.environ.get("NUMBA_BOUNDSCHECK", "").encode())
    folder = HOME / f"kernels-{key.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"glambda-kernels-{key.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
    FOLDERS.add(folder)
    if not any(folder.iterdir()):
        _listen()
    return folder


@cache
def _listen() -> None:
    event.register("numba:compile", _Teller())


class _Teller(event.Listener):
    """Says, once, that kernels of ours are being compiled, as the first of them is."""

    def on_start(self, begun: Any) -> None:
        if begun.data["dispatcher"].py_func.__module__.partition(".")[0] in ("problems", "solvers"):
            _tell_of_compiling()

    def on_end(self, ended: Any) -> None: ...


@cache
def _tell_of_compiling() -> None:
    print("glambda: compiling kernels, once, up to two minutes …", file=sys.stderr)
    if LOST:
        print(f"glambda: {LOST}", file=sys.stderr)


@contextmanager
def _cached_in(folder: str) -> Iterator[dict[str, Any]]:
    """Options for a decorator of numba, while its cache is in `folder`."""
    elsewhere = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
    try:
        yield {"cache": True, "error_model": "numpy", "fastmath": set(FAST_MATH)}
    finally:
        numba.config.CACHE_DIR = elsewhere  # type: ignore[attr-defined]


def kernel_decorator(sources: Sequence[Path], **more: Any) -> Callable[[Any], Any]:
    """Decorator that compiles a function of one of `sources`; it stays callable from the others.

    more : options of `numba.njit`
    """
    folder = str(cache_folder(sources))

    def kernel(function: Any) -> Any:
        with _cached_in(folder) as options:
            options |= {**more, "no_cfunc_wrapper": True}  # who wants to be handed: `Handed`
            return take_literals_as_numbers(numba.njit(**options)(function))

    return kernel


class Handed:
    """A function of one signature, which kernels can be handed by its address."""

    def __init__(self, function: Any, signature: Any, folder: str):
        self._function, self._signature, self._folder = function, signature, folder

    @cached_property
    def _code(self) -> Any:
        with _cached_in(self._folder) as options:
            return numba.cfunc(self._signature, **options)(self._function)

    @property
    def address(self) -> int:
        """Where its machine code is; to ask for it compiles it."""
        address: int = self._code.address
        return address


def function_decorator(sources: Sequence[Path], signature: Any) -> Callable[[Any], Handed]:
    """Decorator that makes a function of one signature one that kernels can be handed."""
    folder = str(cache_folder(sources))

    def function(python_function: Any) -> Handed:
        return Handed(python_function, signature, folder)

    return function


class Direct:
    """`kernel` as a callable that looks at the types of its arguments at the first call only.

    For arguments of the same types at every call, whatever happens: nothing else is checked.
    """

    def __init__(self, kernel: Any):
        self.kernel = kernel
        self._code: Any = None

    @property
    def is_ready(self) -> bool:
        """Whether its machine code has been loaded or made."""
        return self._code is not None

    def __call__(self, *arguments: Any) -> Any:
        if self._code is None:
            signature = tuple(numba.typeof(argument) for argument in arguments)
            self.kernel.compile(signature)
            self._code = self.kernel.overloads[signature].entry_point
        return self._code(*arguments)


SOURCES = sources(defining(Path(__file__).parents[1], "\n@kernel\n"), ["problems"])
kernel = kernel_decorator(SOURCES)
"""Handed an array that may be written to where another call hands one that may not, a kernel is
compiled once more: hence `read_only` where kernels call kernels."""
stage = kernel_decorator(SOURCES, inline="always")
"""A kernel that is a part of one other: its arguments, arrays by the dozen, are not copied."""


@stage
def places(first, past):
    """range(first, past) to index with, where neither is negative.

    An index that might be negative counts from the end.  Where numba must look at each, nothing
    becomes vector instructions; of a range from 0 it knows.
    """
    return range(np.uint64(first), np.uint64(past))
