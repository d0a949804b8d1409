"""Proposition 3: what of the multipliers is unique, and how they move with the data."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import evenly, qps_of, run_of
from harness.judging.facts import rank_of
from problems import ContactQP
from problems.qp import Vector
from solvers import make_solver

SIZES = 10.0 ** -np.arange(4.0, 8.0)
"""η, relative to ‖A‖ and ‖d‖."""
CASES = 12


def _full_rank() -> list[ContactQP]:
    """QPs of fig4 whose columns are independent, evenly chosen."""
    qps = [qp for qp in qps_of(run_of("fig4", 2.5), "step") if rank_of(qp) == qp.k]
    return evenly(qps, CASES)


def _doubled() -> list[ContactQP]:
    """The same with a free column twice, and x shared by the two: A lacks rank."""
    made = []
    for qp in _full_rank():
        x = np.asarray(make_solver("glambda", accuracy=1e-13).solve(qp).x)
        free = np.flatnonzero((x > qp.lower + 1e-3) & (x < qp.upper - 1e-3))
        every = np.append(np.arange(qp.k), free[:1])
        made.append(ContactQP(qp.dense_A[:, every], qp.d, qp.lower[every], qp.upper[every]))
    return made


def _least(qp: ContactQP) -> Vector:
    """x of (3.15), (3.16): equal columns share."""
    x = np.array(make_solver("glambda", accuracy=1e-13).solve(qp).x)
    twice = (qp.dense_A == qp.dense_A[:, -1:]).all(axis=0)
    x[twice] = x[twice].mean()
    return x


@check
def linear(rank: str = "kept") -> float:
    """p in ‖δx‖ = c η^p, the least over QPs of fig4 with A and d perturbed at random.

    rank : "kept", or "changed": one of two equal columns is perturbed
    """
    rng, found = np.random.default_rng(0), []
    for qp in _full_rank() if rank == "kept" else _doubled():
        dA, dd = rng.standard_normal((qp.m, qp.k)), rng.standard_normal(qp.m)
        dA *= np.linalg.norm(qp.dense_A) / np.linalg.norm(dA)
        dd *= np.linalg.norm(qp.d) / np.linalg.norm(dd)
        x, moved = _least(qp), []
        for eta in SIZES:
            A = qp.dense_A + eta * dA
            moved.append(
                np.linalg.norm(_least(ContactQP(A, qp.d + eta * dd, qp.lower, qp.upper)) - x)
            )
        found.append(slope(SIZES, np.array(moved)))
    return min(found)


@check
def equalities(sign: float) -> float:
    """How many x_i ≥ 0 must be equalities on A x = 0, A = (1, sign): |S| of (3.17)."""
    most = [
        -linprog(-np.eye(2)[i], A_eq=[[1.0, sign]], b_eq=[0.0], bounds=[(0.0, 1.0)] * 2).fun
        for i in range(2)
    ]
    return float(sum(value == 0.0 for value in most))


@check
def other_equalities(sign: float) -> float:
    """p in ‖δx‖ = c η^p for A = (1, 0), δA = (0, η), d = 0 and δd = sign η, rank 1 throughout.

    0 ≤ x_1, −1 ≤ x_2 ≤ 1.  On N(A) x_2 is free; with sign = 1 it must be −1 at the answer to
    (3.15)δ, so that S ≠ S_δ.
    """
    moved = [np.linalg.norm(_on_a_line(np.array([1.0, eta]), -sign * eta)) for eta in SIZES]
    return slope(SIZES, np.array(moved))


def _on_a_line(a: Vector, level: float) -> Vector:
    """The least x with a·x = level, 0 ≤ x_1, −1 ≤ x_2 ≤ 1; a·x = level can be met."""
    x, along = a * level / (a @ a), np.array([-a[1], a[0]])
    low, high = np.array([0.0, -1.0]), np.array([np.inf, 1.0])
    ends = np.array([(bound - x)[along != 0] / along[along != 0] for bound in (low, high)])
    return np.asarray(x + along * np.clip(0.0, ends.min(axis=0).max(), ends.max(axis=0).min()))


@check
def same_force(of: str, scale: float = 1.0) -> float:
    """Largest relative distance of A x ("Ax") or x ("x") of two answers to redundant QPs of fig5.

    The answers are our method's, and that of the velocity problem (3.4), cold.
    scale : of d in the second
    """
    one, other, worst = make_solver("glambda", accuracy=1e-12), make_solver("velocity"), 0.0
    for qp in qps_of(run_of("fig5", 0.8), "step"):
        if rank_of(qp) < qp.k:
            changed = ContactQP(qp.A, scale * qp.d, qp.lower, qp.upper)
            x, y = np.asarray(one.solve(qp).x), np.asarray(other.solve(changed).x)
            if of == "Ax":
                x, y = qp.A @ x, qp.A @ y
            worst = max(worst, float(np.linalg.norm(x - y) / np.linalg.norm(x)))
    return worst
