"""Files of others made into recordings: read, checked, brought into our form, and given references.

1. The ending of a file says what it is (`FORMATS`); every number in it is checked.
2. Each problem becomes a QP with bounds only, or several (`harness.exchange.quadratic` and
   `coulomb`); what had to be dropped is measured, recorded, and refused beyond a tolerance.
3. The QPs of a file, in its order, are one recording, `t` their number.  They are taken for a
   sequence, so that warm starts go from one to the next, unless they are said to be apart.
4. ε₀ is `ASKED` of the scale of each QP: nobody else has asked for one.

What holds of the file is told in `parameters`: its name, its sha256, the form, rank and residues.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

from harness.exchange import fclib, maros_meszaros, npz, qpbenchmark, siconos
from harness.exchange.factors import TOLERANCE
from harness.exchange.foreign import FILE_LIMIT, Foreign
from harness.files.plain_files import Unreadable, open_plain
from harness.judging.facts import facts_of
from harness.progress import Progress
from harness.recordings.of_qps import recording_from
from harness.recordings.recording import Recording
from problems.qp import ContactQP

ASKED = 1e-6
READERS = (npz, qpbenchmark, maros_meszaros, fclib, siconos)
FORMATS: Mapping[str, ModuleType] = {end: reader for reader in READERS for end in reader.SUFFIXES}
"""Ending → module whose `read` takes the open file."""


def import_files(
    paths: Sequence[str | Path],
    *,
    name: str | None = None,
    apart: bool = False,
    tolerance: float = TOLERANCE,
    progress: Progress | None = None,
) -> Recording:
    """One recording of the problems of one file, or of several in the order given.

    name : label; default: that of the first file, without its ending
    apart : whether no QP has to do with the one before
    tolerance : relative size of what may be dropped (`harness.exchange.factors`)
    progress : called with "read" (files) and "reference" (QPs)

    Raises ValueError in one line, with file, field and remedy, for what cannot be taken.
    """
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance = {tolerance}; give a number from 0 to 1")
    qps: list[ContactQP] = []
    files: list[Path] = []
    notes: dict[str, Any] = {}
    digest = hashlib.sha256()
    for number, path in enumerate(map(Path, paths)):
        if progress is not None:
            progress("read", number, len(paths))
        for made, said in read_problems(path, tolerance, digest):
            first = len(qps)
            files += [path] * len(made)
            qps += [
                replace(qp, t=float(first + i), restart=i == 0 and (apart or first == 0))
                for i, qp in enumerate(made)
            ]
            notes = _worst(notes, said)
    label = Path(paths[0]).stem if name is None else name
    for i, (qp, path) in enumerate(zip(qps, files, strict=True)):
        try:
            qps[i] = qp.with_accuracy(ASKED * facts_of(qp).scale)
        except ValueError as error:
            raise _refusal(path, f"QP {i - files.index(path)}: {error}") from None
    about = {
        "source": "import",
        "import.file": Path(paths[0]).name,
        "import.files": len(paths),
        "import.sha256": digest.hexdigest(),
        "import.tolerance": tolerance,
        **notes,
    }
    return recording_from(qps, label, parameters=about, progress=progress)


def read_problems(
    path: Path, tolerance: float = TOLERANCE, digest: Any = None
) -> list[tuple[list[ContactQP], dict[str, Any]]]:
    """For each problem of a file its QPs and what is to be said of it.

    digest : takes the bytes of the file

    Raises ValueError like `import_files`, OSError where there is no file.
    """
    reader = FORMATS.get(path.suffix.lower())
    if reader is None:
        raise _refusal(path, f"ending: {path.suffix or 'none'} is unknown; known: "
                             f"{', '.join(FORMATS)}")  # fmt: skip
    try:
        with open_plain(path, FILE_LIMIT) as file:
            if digest is not None:
                digest.update(file.read())
                file.seek(0)
            made = [problem.qps(tolerance) for problem in reader.read(file)]
    except (Foreign, Unreadable) as error:
        raise _refusal(path, str(error)) from None
    except (ValueError, MemoryError, ArithmeticError) as error:  # LinAlgError is a ValueError
        raise _refusal(path, f"values: {error}") from None
    if not made:
        raise _refusal(path, "file: holds no problem")
    return made


def _refusal(path: Path, what: str) -> ValueError:
    return ValueError(" ".join(f"{path}: {what}".split()))


def _worst(notes: dict[str, Any], said: Mapping[str, Any]) -> dict[str, Any]:
    """Notes of several problems: figures at their worst, others where they agree."""
    if not notes:
        return dict(said)
    out = {}
    for name in notes.keys() | said.keys():
        one, other = notes.get(name), said.get(name)
        if one == other:
            out[name] = one
        elif isinstance(one, float) and isinstance(other, float):
            out[name] = min(one, other) if name == "import.least" else max(one, other)
        else:
            out[name] = "various"
    return out
