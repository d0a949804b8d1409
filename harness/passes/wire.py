"""What parent and measured process say to each other: one QP down, one answer up, as bytes.

1. A question is a QP, alone: no later one, no file, no reference but in the arm that starts from
   it.  Its arrays stand in the message, which the process reads as they stand.
2. An answer has a length that is known before it comes, and begins with the token of its question,
   drawn anew each time: who writes out of turn is found out.
3. Whatever else stands in an answer, it decodes to an `Outcome`.
"""

from __future__ import annotations

import math
import os
import struct
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from harness.passes.outcome import Outcome
from problems.qp import FEATURE_FIELDS, KINDS, ContactQP, Status, Vector, WorkCounts

TEXT = 400
"""Longest status text that is kept [bytes]."""
TOKEN = 8
"""Bytes that an answer begins with."""
READY = b"ready..."
"""What a process says before the first question."""
LENGTH = 8
"""Bytes of the length that goes before a question."""
TOLD = ("build", "setup", "solve", "call", "inside")
"""The times that a process tells of its own solve [s]; the last by the package's own clock."""
COUNTS = tuple(WorkCounts.__dataclass_fields__)
QUESTION = struct.Struct(f"<{TOKEN}s 8q 4d 4?4x")
ANSWER = struct.Struct(f"<{TOKEN}s 5?3x 9s16s{TEXT}s7x q {len(COUNTS)}q {len(TOLD)}d")
SETTLED = ("", "skipped", "failed", "timeout", "crashed")
"""What an answer may say before any judging."""
NONSENSE = "what it recorded is no answer"


class Question(NamedTuple):
    """A QP as a process is asked it.

    number : of the QP in the recording;  reference : (k,) x to start from, or None
    alone : whether it has no predecessor;  fresh : whether it is the first of a pass
    """

    number: int
    qp: ContactQP
    reference: Vector | None = None
    alone: bool = False
    fresh: bool = False


def packed(question: Question) -> bytearray:
    """The question as bytes, behind a new token."""
    qp = question.qp
    A: Any = qp.A
    nonzeros, width = -1, 0
    matrix: tuple[NDArray[Any], ...] = (A,)
    if sp.issparse(A):
        matrix, nonzeros, width = (A.data, A.indptr, A.indices), A.nnz, A.indices.itemsize
    V, x = qp.generators, question.reference
    optional = [array for array in (V, x) if array is not None]
    parts = (qp.d, qp.lower, qp.upper, qp.D, qp.row_id, qp.feature, *optional, *matrix)
    head = QUESTION.pack(
        os.urandom(TOKEN),
        *(question.number, qp.m, qp.k, KINDS.index(qp.kind), nonzeros, width),
        *(-1 if V is None else len(V), x is not None),
        *(qp.t, qp.h, qp.alpha0, qp.eps0),
        *(qp.accepted, qp.restart, question.alone, question.fresh),
    )
    return bytearray().join((head, *(part.tobytes() for part in parts)))


class _Reader:
    """Takes arrays off a message, one after the other, without copying."""

    def __init__(self, message: bytearray, at: int) -> None:
        self.message, self.at = message, at

    def take(self, kind: type, *shape: int) -> NDArray[Any]:
        count = math.prod(shape)
        array: NDArray[Any] = np.frombuffer(self.message, kind, count, self.at).reshape(shape)
        self.at += array.nbytes
        return array


def unpacked(message: bytearray) -> Question:
    """The question that `packed` made."""
    _, *sizes, t, h, alpha0, eps0, accepted, restart, alone, fresh = QUESTION.unpack_from(message)
    number, m, k, kind, nonzeros, width, lines, has_reference = sizes
    read = _Reader(message, QUESTION.size)
    real, whole = np.float64, np.int64
    fields: dict[str, Any] = {
        **{name: read.take(real, size) for name, size in zip(_VECTORS, (m, k, k, m), strict=True)},
        "row_id": read.take(whole, k),
        "feature": read.take(whole, k, len(FEATURE_FIELDS)),
    }
    V = None if lines < 0 else read.take(real, lines, k)
    if V is not None:
        V.setflags(write=False)
    reference = read.take(real, k) if has_reference else None
    if nonzeros < 0:
        fields["A"] = read.take(real, m, k)
    else:
        index = np.int32 if width == 4 else np.int64
        data, indptr = read.take(real, nonzeros), read.take(index, k + 1)
        A = sp.csc_array((data, read.take(index, nonzeros), indptr), shape=(m, k))
        A.has_canonical_format = True
        fields["A"] = A
    qp = ContactQP.of_own(
        **fields, kind=KINDS[kind], accepted=accepted, restart=restart, t=t, h=h,
        alpha0=alpha0, eps0=eps0,
    )  # fmt: skip
    vars(qp)["generators"] = V
    return Question(number, qp, reference, alone, fresh)


_VECTORS = ("d", "lower", "upper", "D")


def answer_size(k: int) -> int:
    """Bytes of the answer to a QP of k columns."""
    return ANSWER.size + 8 * k


def answered(message: bytearray, outcome: Outcome, told: tuple[float, ...], k: int) -> bytes:
    """The answer to the question `message`, as bytes."""
    try:
        return _answered(message, outcome, told, k)
    except (TypeError, ValueError, OverflowError, AttributeError, struct.error) as error:
        text = f"{NONSENSE}: {error}"
        return _answered(message, Outcome("failed", status_text=text), (np.nan,) * 3 + told[3:], k)


def _answered(message: bytearray, outcome: Outcome, told: tuple[float, ...], k: int) -> bytes:
    work, x = outcome.work, outcome.x
    return ANSWER.pack(
        message[:TOKEN],
        *(x is not None, outcome.iterations is not None, work is not None),
        *(outcome.found, outcome.warm_started),
        (outcome.verdict or "").encode(),
        outcome.status.encode(),
        " ".join(outcome.status_text.split()).encode(errors="replace"),
        outcome.iterations or 0,
        *(0 if work is None else getattr(work, name) for name in COUNTS),
        *told,
    ) + (bytes(8 * k) if x is None else x.tobytes())


def outcome_of(answer: bytes) -> tuple[Outcome, tuple[float, ...]]:
    """Outcome and times `TOLD` that an answer gives."""
    _, has_x, has_iterations, has_work, found, warm, *texts = ANSWER.unpack_from(answer)
    iterations, counts, told = texts[3], texts[4 : 4 + len(COUNTS)], tuple(texts[-len(TOLD) :])
    verdict, status, text = (
        raw.rstrip(b"\0").decode(errors="replace").replace("\0", " ") for raw in texts[:3]
    )
    if verdict not in SETTLED or status not in ("", *Status.__members__):
        return Outcome("crashed", status_text=NONSENSE), told
    x = np.frombuffer(answer, np.float64, offset=ANSWER.size) if has_x else None
    return Outcome(
        verdict=verdict or None,
        x=x,
        found=found,
        status=status,
        status_text=text,
        iterations=iterations if has_iterations else None,
        work=WorkCounts(*counts) if has_work else None,
        warm_started=warm,
    ), told
