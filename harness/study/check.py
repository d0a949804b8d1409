"""Is this solver, scene or recording right? What its maker wants to know before a study does.

Each function yields findings, one per question, in the order in which they are best put right.

**A solver** is given two short recordings and some odd QPs, as in a study: in a process of its own,
cold and warm, at the accuracy `high`.  Wrong is an answer that claims to be right and is not, none
at all, a crash, a QP written into, and a warm start that makes the answer worse.

**A scene** must be made alike twice, move, and make a recording that is read as it was written;
what its motion says of the physics is told (`harness.motions.run_physics`).

**A recording** must be readable, and its references must be those that the oracle finds today.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy.sparse as sp

from harness.judging.judge import judge
from harness.judging.oracle import reference
from harness.motions.run_physics import physics_of
from harness.passes.starts import ARMS
from harness.processes.introduction import about
from harness.recordings.of_qps import recording_from
from harness.recordings.recording import Recording, RecordingError, read_recording, write_recording
from harness.study.record import record, recording_of
from harness.study.replay import replay
from problems import ContactQP, simulate
from problems import scene as make_scene
from problems.scenes import Scene
from problems.scenes.labels import parse_label
from solvers import make_solver

SCENES = (("fig3", 1.2), ("fig4", 0.6))
"""Scenes whose QPs a solver is given, and the ends of their motions [s]."""
WRONG = ("claimed_wrong", "failed", "timeout", "crashed")
"""Verdicts that a solver should not have; `inaccurate` and `undecided` are told, and
`skipped` is its right."""
TIME_LIMIT = 10.0
"""[s] per QP."""
ALIKE = ("verdict", "status", "iterations", "glambda_error", "error_bound")
"""Columns that are the same when a QP is solved again."""


class Finding(NamedTuple):
    """An answer: the question, whether all is well, and in words."""

    question: str
    right: bool
    words: str


def check_solver(name: str) -> Iterator[Finding]:
    """Questions to the solver called `name`.

    Raises ValueError for an unknown name and ImportError where its package is absent.
    """
    known = about(name)
    yield Finding("is there", not known.broken, known.reason or known.version)
    if known.broken:
        return
    for scene, until in SCENES:
        rows = _replayed(record(_scene(scene), until=until), name)
        for arm, part in rows.groupby("arm"):
            yield _verdicts(f"solves {scene}, {arm}", part)
        arms = rows.pivot(index="problem", columns="arm", values="verdict")
        if "warm" in arms:
            worse = arms.index[(arms["cold"] == "verified") & (arms["warm"] != "verified")]
            words = f"{len(worse)} QPs are worse, first {worse[0]}" if len(worse) else "yes"
            yield Finding(f"is as right warm as cold, {scene}", not len(worse), words)
    odd = odd_qps()
    posed = recording_from(list(odd.values()), "odd QPs")
    rows, again = (_replayed(posed, name, ("cold",)).sort_values("step") for _ in range(2))
    for kind, (_, row) in zip(odd, rows.iterrows(), strict=True):
        yield _verdicts(f"solves {kind}", row.to_frame().T)
    same = all(rows[what].equals(again[what]) for what in ALIKE)
    yield Finding("answers alike twice", same, "yes" if same else "no: is there hidden state?")


def odd_qps() -> dict[str, ContactQP]:
    """QPs that a motion may pose and that packages stumble over, by what is odd."""
    rng = np.random.default_rng(0)
    A, d = rng.standard_normal((6, 4)), rng.standard_normal(6)
    zero, one, inf = np.zeros(4), np.ones(4), np.full(4, np.inf)
    twice = np.hstack([A[:, :2], A[:, :2]])
    return {
        "a QP without columns": ContactQP(np.zeros((6, 0)), d, np.zeros(0), np.zeros(0)),
        "a QP whose rows are all fixed": ContactQP(A, d, 0.1 * one, 0.1 * one),
        "some fixed rows": ContactQP(A, d, zero, np.array([np.inf, 0.0, 1.0, 0.0])),
        "free rows": ContactQP(A, d, -inf, inf),
        "upper bounds only": ContactQP(A, d, -inf, 0.1 * one),
        "two bounds": ContactQP(A, d, -0.1 * one, 0.1 * one),
        "redundant contacts": ContactQP(twice, d, zero, inf),
        "a column of zeros": ContactQP(A * [1, 1, 0, 1], d, zero, inf),
        "a sparse A": ContactQP(sp.csc_array(A), d, zero, inf),
        "large numbers": ContactQP(1e4 * A, 1e6 * d, zero, inf, eps0=1e-3),
        "an answer of zero": ContactQP(A, -A @ one, zero, zero + 2.0).with_accuracy(1e-6),
    }


def _replayed(made: Recording, name: str, arms: Sequence[str] = ARMS) -> pd.DataFrame:
    return replay(made, [name], ("high",), arms, repeats=1, time_limit=TIME_LIMIT)


def _verdicts(question: str, rows: pd.DataFrame) -> Finding:
    counts = rows["verdict"].value_counts()
    words = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    wrong = rows[rows["verdict"].isin(WRONG)]
    if len(wrong):
        first = wrong.iloc[0]
        words += f"; first {first['problem']}: {first['status_text'] or first['verdict']}"
    return Finding(question, not len(wrong), words)


def check_scene(label: str, until: float | None = None) -> Iterator[Finding]:
    """Questions to a scene, such as "fig4,mu_I=0.8".

    until : end of the motion [s]; None: the scene's own

    Raises ValueError for an unknown scene or parameter.
    """
    scene, again = _scene(label), _scene(label)
    yield Finding("is there", True, f"{len(scene.bodies)} bodies, called {scene.label}")
    same = np.array_equal(scene.q0, again.q0) and np.array_equal(scene.v0, again.v0)
    yield Finding("is made alike twice", same, "yes" if same else "no: give its chance a seed")
    solver = make_solver("glambda")
    run = simulate(scene, solver, until=until)
    yield Finding("moves", True, f"to t = {run.t[-1]:g} s in {run.counts['steps']} steps")
    found = physics_of(run)
    words = ", ".join(f"{what} {value:.2g}" for what, value in found.items())
    yield Finding("physics (told, not judged)", True, words)
    made = recording_of(run, solver.name, until=until)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        try:
            write_recording(path, made)
            right = read_recording(path).digest == made.digest
            words = f"{len(made.qps)} QPs" if right else "it is not read as it was written"
        except (ValueError, TypeError) as error:
            right, words = False, str(error)
    yield Finding("can be recorded", right, words)


def _scene(label: str) -> Scene:
    name, parameters = parse_label(label)
    return make_scene(name, **parameters)


def check_recording(path: str | Path) -> Iterator[Finding]:
    """Questions to a recording's file.

    Raises FileNotFoundError or IsADirectoryError where there is none.
    """
    with open(path, "rb"):
        pass
    try:
        made = read_recording(path)
    except RecordingError as error:
        yield Finding("can be read", False, str(error))
        return
    yield Finding("can be read", True, f"{made.scene}, {len(made.qps)} QPs, {made.digest[:12]}…")
    yield _references(made)
    known = [
        (qp, solution, ref)
        for qp, solution, ref in zip(made.qps, made.solutions, made.references, strict=True)
        if ref is not None and solution.x is not None
    ]
    far = [
        qp.t for qp, solution, ref in known if judge(qp, solution.x, reference=ref).verdict in WRONG
    ]
    words = f"{len(known) - len(far)} of {len(known)}"
    if far:
        words += f"; not at t = {far[0]:g} s"
    yield Finding("its own answers are near its references", not far, words)


def _references(made: Recording) -> Finding:
    """Whether the oracle finds today what was recorded."""
    proofs: Counter[str] = Counter()
    wrong = []
    for i, (qp, kept) in enumerate(zip(made.qps, made.references, strict=True)):
        proofs["none" if kept is None else kept.proof] += 1
        found = reference(qp) if kept is not None else None
        if kept is None or found is None:
            continue
        rounding = 1e-15 * (float(np.linalg.norm(kept.Ax)) + float(np.linalg.norm(qp.d)))
        apart = float(np.linalg.norm(found.Ax - kept.Ax))
        if apart > found.error_bound + kept.error_bound + rounding:
            wrong.append((i, apart))
    words = ", ".join(f"{count} {proof}" for proof, count in proofs.most_common())
    if wrong:
        words += f"; {len(wrong)} are not what the oracle finds, first QP {wrong[0][0]}, "
        words += f"by {wrong[0][1]:.2g}"
    return Finding("its references hold", not wrong, words)
