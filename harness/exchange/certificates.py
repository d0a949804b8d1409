"""Certificates that others can check: of each QP the working set and x in exact arithmetic.

The recorded float64 are rational numbers, and so is the answer that `harness.judging.proof` finds.
It is written out with the QP itself, as JSON; `check_certificate.py`, a file that imports nothing
of ours, says what must hold and checks it.  QPs whose exact answer takes too much work, and those
without columns, are named as having none.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import scipy.sparse as sp

from harness.exchange.check_certificate import FORMAT
from harness.files.whole_files import write_whole
from harness.judging.proof import MANY_COLUMNS, exact_answer
from harness.progress import Progress
from harness.recordings.recording import Recording
from problems.qp import ContactQP

CHECKER = Path(__file__).with_name("check_certificate.py")


class Certified(NamedTuple):
    """How many QPs have a certificate, and the numbers of those that have none."""

    made: int
    without: tuple[int, ...]


def certify(recording: Recording, path: str | Path, progress: Progress | None = None) -> Certified:
    """Write the certificates of a recording.

    progress : called with "certify" (QPs)
    """
    made, without = [], []
    for number, (qp, known) in enumerate(zip(recording.qps, recording.references, strict=True)):
        if progress is not None:
            progress("certify", number, len(recording.qps))
        x = None
        if qp.k and known is not None:
            x = exact_answer(qp, known.x, columns=MANY_COLUMNS)
        if x is None:
            without.append(number)
        else:
            made.append({"number": number, **certificate(qp, *x)})
    content = {
        "format": FORMAT,
        "recording": recording.scene,
        "digest": recording.digest,
        "count": len(recording.qps),
        "without": without,
        "qps": made,
    }
    write_whole(Path(path), json.dumps(content, separators=(",", ":")).encode())
    return Certified(len(made), tuple(without))


def certificate(qp: ContactQP, numerators: list[int], denominator: int) -> dict[str, Any]:
    """A QP with its exact x."""
    A = sp.csc_array(qp.A)
    entries = [
        (int(row), value.hex()) for row, value in zip(A.indices, A.data.tolist(), strict=True)
    ]
    ends = A.indptr.tolist()
    members = [
        _member(value, low, high, denominator)
        for value, low, high in zip(numerators, qp.lower.tolist(), qp.upper.tolist(), strict=True)
    ]
    return {
        "A": [entries[start:end] for start, end in pairwise(ends)],
        "d": [value.hex() for value in qp.d.tolist()],
        "lower": [value.hex() for value in qp.lower.tolist()],
        "upper": [value.hex() for value in qp.upper.tolist()],
        "working_set": members,
        "denominator": hex(denominator),
        "numerators": [hex(value) for value in numerators],
    }


def _member(value: int, low: float, high: float, one: int) -> int:
    """−1 at the lower bound, 1 at the upper, else 0."""
    for bound, member in ((low, -1), (high, 1)):
        if abs(bound) != float("inf"):
            above, below = bound.as_integer_ratio()
            if value * below == above * one:
                return member
    return 0
