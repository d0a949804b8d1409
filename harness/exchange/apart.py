"""Foreign bytes in the hands of libraries that are made for sound files: in a process apart.

A flipped bit makes SciPy's reader of MATLAB files write where it should not, and can keep HDF5 busy
for ever.  So a fork of this process reads: it may take `SECONDS` of computing, one more for each
`BYTES` of the file, and what memory there is; it hands back arrays through a file, and if it dies,
that is said of the file.  Where the system cannot fork, it is read here.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import tempfile
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np

from harness.exchange.foreign import Foreign
from harness.machine.memory import available_memory
from harness.processes.own_process import begin, cause_of_death

SECONDS, BYTES = 6, 1_000_000
Arrays = Mapping[str, np.ndarray]


def arrays_apart(extract: Callable[[BinaryIO], Arrays], file: BinaryIO) -> dict[str, np.ndarray]:
    """Arrays by name that `extract` finds in an open file.

    Raises the Foreign that it raises, or one that says how it ended.
    """
    if not hasattr(os, "fork"):
        return dict(extract(file))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "arrays.npz"
        with warnings.catch_warnings():
            # the child computes nothing that another thread of ours may have begun
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            _work(extract, file, out)
        try:
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        except BaseException:
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
            raise
        refusal = out.with_suffix(".txt")
        if refusal.exists():
            raise Foreign(refusal.read_text(encoding="utf-8"))
        if code != 0 or not out.exists():
            raise Foreign(f"file: its library ended with {cause_of_death(code)}: "
                          "the file is damaged, or too large")  # fmt: skip
        with np.load(out, allow_pickle=False) as found:
            return dict(found)


def _work(extract: Callable[[BinaryIO], Arrays], file: BinaryIO, out: Path) -> None:
    """The life of the child; it does not return."""
    import resource  # where there is no fork, there is none of this

    code = 1
    try:
        begin(out.parent)
        faulthandler.disable()  # a crash is told of by the parent
        seconds = SECONDS + os.fstat(file.fileno()).st_size // BYTES
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        room = resource.getrlimit(resource.RLIMIT_AS)[1]
        ours = int(available_memory()) + (1 << 32)  # what is mapped already is counted, too
        if room == resource.RLIM_INFINITY or ours < room:
            resource.setrlimit(resource.RLIMIT_AS, (ours, room))
        try:
            with open(out, "wb") as target:
                np.savez(target, **extract(file))  # type: ignore[arg-type]
        except Foreign as error:
            out.with_suffix(".txt").write_text(str(error), encoding="utf-8")
        code = 0
    finally:
        os._exit(code)
