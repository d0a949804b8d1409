"""Coulomb's disc as it is, by bounds alone, and as a polygon: one step, the same Gλ?

For each accepted step of a motion in space the QP with discs (6.1) that it has solved is kept, with
the answer by bounds alone (`problems.space.discs`).  It is solved again by packages that take
cones, and with polygons in place of the discs.  All are held against the bound on their error,
which rests on x alone and covers discs.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.cases.bodies import Found, found
from harness.cases.cones import BY_DISCS
from harness.judging.disc_bound import disc_error_bound
from problems import scene, simulate
from problems.qp import Vector
from problems.sequence import SolvesQPs
from problems.space.discs import DiscQP

MOTIONS: dict[str, dict[str, Any]] = {
    "slope": {"heading": 0.35, "until": 0.2},
    "skid": {"spin": 4.0, "speed": 1.5, "mu": 0.3, "height": 0.1, "until": 0.3},
    "space_tower": {"bodies": 3, "until": 0.1},
}
"""Scene → parameters, and how long: all slide, some stick, all stick."""
STEP, EPS, ACCURACY = 0.01, 1e-6, 1e-12
EVERY = 3
"""Of so many steps one is solved by others."""
FACES = (4, 8, 16)


def friction_discs(solver: SolvesQPs) -> list[Found]:
    """Largest errors over the steps of each motion, relative to ‖A x‖."""
    rows = []
    for name, given in MOTIONS.items():
        parameters = {key: value for key, value in given.items() if key != "until"}
        made = scene(name, **parameters)
        run = simulate(made, solver, until=given["until"], fixed_step=STEP, eps=EPS)
        posed = run.discs[::EVERY]
        rows.append(_row(name, "by bounds alone, bound", [_bound(qp, x, x) for qp, x in posed]))
        for package, solve in BY_DISCS.items():
            answers = [solve(qp, ACCURACY) for qp, _ in posed]
            pairs = [(qp, y, x) for (qp, x), y in zip(posed, answers, strict=True)]
            rows.append(_row(name, f"{package}, bound", [_bound(*each) for each in pairs]))
            rows.append(_row(name, f"{package}, off ours", [_apart(*each) for each in pairs]))
        for faces in FACES:
            answers = [_by_polygon(qp, faces, solver) for qp, _ in posed]
            off = [_apart(qp, y, x) for (qp, x), y in zip(posed, answers, strict=True)]
            rows.append(_row(name, f"polygon of {faces}, off the disc", off, np.nan))
    return rows


def _row(name: str, words: str, values: list[float], expected: float = 0.0) -> Found:
    return found(f"{name}: {words}", max(values), expected)


def _by_polygon(qp: DiscQP, faces: int, solver: SolvesQPs) -> Vector:
    """x (k,) with polygons for discs."""
    posed, T = qp.faceted(faces)
    x = solver.solve(posed).x
    if x is None:
        raise ValueError("the solver gave no answer with polygons")
    return np.asarray(T @ x)


def _apart(qp: DiscQP, y: Vector, x: Vector) -> float:
    return float(np.linalg.norm(qp.A @ (y - x)) / np.linalg.norm(qp.A @ x))


def _bound(qp: DiscQP, y: Vector, x: Vector) -> float:
    return disc_error_bound(qp, y) / float(np.linalg.norm(qp.A @ x))
