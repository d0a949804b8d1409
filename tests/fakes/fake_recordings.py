"""Small recordings for tests of the harness: random QPs with known answers, no physics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from harness.recordings.layout import SpaceMotion
from harness.recordings.recording import PROOFS, Recording, Reference
from problems.qp import ContactQP, Solution, Status, WorkCounts, working_set_of
from problems.space.discs import DiscQP
from problems.space.solids import ball, polyhedron
from problems.stepping.run import Event
from tests.fakes.random_qps import contact_sequence, random_qp

ODD_KINDS = ("bilateral", "sparse_columns", "rank_deficient", "empty", "fixed_rows")


def solution_of(qp: ContactQP, x: Any, **fields: Any) -> Solution:
    """A solution that claims success."""
    x = np.array(x, float)
    return Solution(x, qp.row_id, Status.SOLVED, working_set_of(qp, x), **fields)


def fake_recording(scene: str = "fake", seed: int = 0, length: int = 6) -> Recording:
    """A contact sequence with a restart, an impulse with generators and some odd QPs.

    The references are the known A x*, with x = the least-squares preimage.
    """
    cases = contact_sequence(seed, length) + [random_qp(kind, seed) for kind in ODD_KINDS]
    qps, references, solutions = [], [], []
    for i, (qp, Ax) in enumerate(cases):
        kind = "step" if i < length else "impulse"
        V = np.ones((2, qp.k)) if i == length else None
        qp = replace(qp, kind=kind, restart=i == 3, t=0.01 * i, h=0.01, eps0=1e-6, generators=V)
        x = np.linalg.lstsq(qp.dense_A, Ax, rcond=None)[0]
        qps.append(qp)
        references.append(Reference(x, Ax, 1e-14, PROOFS[i % 3]) if i != 4 else None)
        work = WorkCounts(1, 2, 3, 4, 5, 6) if i % 2 else None
        solutions.append(solution_of(qp, x, iterations=i, status_text="ok µ", work=work))
    solutions[1] = replace(solutions[1], x=None, status=Status.FAILED)
    t = 0.01 * np.arange(3)
    return Recording(
        scene=scene,
        parameters={"mu": 0.5, "boxes": 2, "name": "x", "flag": True},
        eps=1e-3,
        gravity=9.81,
        code_version="test",
        qps=tuple(qps),
        solutions=tuple(solutions),
        references=tuple(references),
        mu=tuple(0.5 * (np.arange(qp.k) % 3 == 1) for qp in qps),
        polygons=[[np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])], [np.zeros((4, 2))] * 2],
        t=t,
        q=np.arange(18.0).reshape(3, 2, 3),
        v=np.zeros((3, 2, 3)),
        events=(Event(0.01, "impulse", "body 1 on body 2, μ"),),
        counts={"steps": 3, "restarts": 1},
    )


def fake_in_space(seed: int = 0) -> Recording:
    """The same with a ball and a tetrahedron in space, and QPs with discs, dense and sparse."""
    rng = np.random.default_rng([seed, 1])
    solids = ball(0.5), polyhedron([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])[0]
    poses = np.zeros((3, 2, 7))
    poses[..., :3], poses[..., 3] = rng.standard_normal((3, 2, 3)), 1.0
    velocities, reactions = rng.standard_normal((2, 3, 2, 6))
    space = SpaceMotion.of(solids, poses, velocities, reactions)
    discs = tuple(_fake_discs(rng, contacts, t) for t, contacts in enumerate((2, 0, 1)))
    none = np.zeros((3, 0, 3))
    return replace(fake_recording(), polygons=(), q=none, v=none, space=space, discs=discs)


def _fake_discs(rng: np.random.Generator, contacts: int, t: float) -> tuple[DiscQP, Any]:
    k = 3 * contacts
    A: Any = rng.standard_normal((12, k))
    lower = np.where(np.arange(k) < contacts, 0.0, -np.inf)
    pairs = contacts + np.arange(2 * contacts).reshape(-1, 2)
    qp = DiscQP(
        sp.csc_array(A) if contacts == 1 else A,
        rng.standard_normal(12),
        lower,
        np.full(k, np.inf),
        pairs,
        rng.uniform(0.0, 1.0, contacts),
        float(t),
    )
    return qp, qp.projected(rng.standard_normal(k))
