"""A recording of QPs that were not posed by the stepper: one's own, imported, or of an engine.

They have no motion, no bodies and no events; each gets a reference (`harness.judging.oracle`), so
that answers are judged as those of a scene are.  Where nobody said what ε or gravity was, they are
NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from harness.judging.oracle import reference
from harness.progress import Progress
from harness.recordings.recording import Recording
from problems.qp import ContactQP, Solution, Status, working_set_of

UNKNOWN = float("nan")


def recording_from(
    qps: Sequence[ContactQP],
    scene: str = "qps",
    *,
    parameters: Mapping[str, Any] | None = None,
    answers: Sequence[ArrayLike | None] | None = None,
    eps: float = UNKNOWN,
    gravity: float = UNKNOWN,
    progress: Progress | None = None,
) -> Recording:
    """The recording of a sequence of QPs, each with a reference answer.

    A warm start goes from one QP to the next, rows mapped by `row_id`, but for `restart`.

    qps : in solve order;  scene : label, which becomes the name of the file
    parameters : numbers, texts and truth values that say where they come from
    answers : one for each QP, x (k,) of whoever posed them, or None
    eps, gravity : of the run, where there are such
    progress : called with "reference" (QPs)

    Raises ValueError where there are no QPs, or other numbers of answers.
    """
    qps = tuple(qps)
    if not qps:
        raise ValueError("there are no QPs; give at least one")
    given = [None] * len(qps) if answers is None else list(answers)
    if len(given) != len(qps):
        raise ValueError(f"{len(qps)} QPs need as many answers; got {len(given)}")
    solutions = tuple(_solution(qp, x) for qp, x in zip(qps, given, strict=True))
    references = []
    for i, (qp, solution) in enumerate(zip(qps, solutions, strict=True)):
        if progress is not None:
            progress("reference", i, len(qps))
        references.append(reference(qp, start=solution.x))
    none = np.zeros((0, 0, 3))
    return Recording(
        scene=scene,
        parameters=dict(parameters or {}),
        eps=float(eps),
        gravity=float(gravity),
        code_version=f"glambda {metadata.version('glambda')}",
        qps=qps,
        solutions=solutions,
        references=tuple(references),
        mu=tuple(np.zeros(qp.k) for qp in qps),
        polygons=(),
        t=np.zeros(0),
        q=none,
        v=none,
        events=(),
        counts={},
    )


def _solution(qp: ContactQP, x: ArrayLike | None) -> Solution:
    if x is None:
        return Solution(None, qp.row_id, Status.FAILED, np.zeros(qp.k, np.int8))
    x = np.array(x, float)
    if x.shape != (qp.k,):
        raise ValueError(f"A has shape {(qp.m, qp.k)}, so an answer needs {qp.k} entries; "
                         f"got shape {x.shape}")  # fmt: skip
    return Solution(x, qp.row_id, Status.SOLVED, working_set_of(qp, x))
