"""Impulses (2.13), (2.14), §4.3: energy, bounces, the dual problem (4.10)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import qps_of, run_of
from problems import ContactQP
from problems.qp import Indices, Vector
from solvers import make_solver

ACCURACY = 1e-13
UNTIL = 2.5


def _solved(mu_I: float, part: float = 1.0) -> Iterator[tuple[ContactQP, Vector]]:
    """The impulses of fig4 and c of Λ = V c, of which only a `part` acts."""
    solver = make_solver("glambda", accuracy=ACCURACY)
    for qp in qps_of(run_of("fig4", UNTIL, mu_I=mu_I), "impulse"):
        yield qp, part * np.asarray(solver.solve(qp).x)


@check
def energy(mu_I: float, part: float = 1.0) -> float:
    """Largest |2ΔT + ‖AΛ‖²| over 2T before, T counted after F.

    part : of the impulse that acts; 1 is (2.14)
    """
    worst = 0.0
    for qp, c in _solved(mu_I, part):
        before, lost = float(qp.d @ qp.d), float(np.linalg.norm(qp.A @ c) ** 2)
        after = float(np.linalg.norm(qp.residual(c)) ** 2)
        worst = max(worst, abs(after - before + lost) / before)
    return worst


@check
def friction_term(mu_I: float) -> float:
    """Largest second term of (4.12), Σ Λ_F g_Fᵀq̇₋, over 2T, of a body that hits with two corners.

    Columns and q̇₋ are drawn, with g_Nᵀq̇₋ ≤ 0.
    """
    rng, most = np.random.default_rng(0), 0.0
    for _ in range(300):
        N, F = rng.standard_normal((2, 3, 2))
        N *= -np.sign(N.T @ (before := rng.standard_normal(3)))
        A = np.column_stack([N + mu_I * F, N - mu_I * F])
        qp = ContactQP(A, before, np.zeros(4), np.full(4, np.inf))
        c = np.asarray(make_solver("glambda", accuracy=ACCURACY).solve(qp).x)
        term = mu_I * (c[:2] - c[2:]) @ (F.T @ before)
        most = max(most, float(term / (before @ before)))
    return most


@check
def bounce(mu_I: float, part: float = 1.0) -> float:
    """Largest |g_Nᵀq̇₊ − μ_I |g_Fᵀq̇₊|| of contacts at the edge of their cone, over ‖q̇₋‖_M."""
    worst = 0.0
    for qp, c in _solved(mu_I, part):
        first, second = _pairs(qp)
        speed = qp.gradient(c)
        normal, slip = 0.5 * (speed[first] + speed[second]), 0.5 * (speed[first] - speed[second])
        edge = (c[first] > 0) != (c[second] > 0)
        off = np.abs(normal - np.abs(slip))[edge]
        worst = max(worst, float(off.max(initial=0.0) / np.linalg.norm(qp.d)))
    return worst


@check
def dual(mu_I: float, change: float = 0.0) -> float:
    """Largest distance of q̇₊ by (2.14) from that by the dual (4.10), over ‖q̇₋‖_M.

    change : of q̇₋ in the dual, relative
    """
    other, worst = make_solver("velocity"), 0.0
    for qp, c in _solved(mu_I):
        changed = ContactQP(qp.A, (1 + change) * qp.d, qp.lower, qp.upper)
        apart = qp.residual(c) - changed.residual(np.asarray(other.solve(changed).x))
        worst = max(worst, float(np.linalg.norm(apart) / np.linalg.norm(qp.d)))
    return worst


@check
def count_ratio(mu_I: float) -> float:
    """Impulses of fig4 with μ_I over those without, until both have come to rest."""
    counts = [run_of("fig4", 12.0, mu_I=mu).counts["impulses"] for mu in (mu_I, 0.0)]
    return counts[0] / counts[1]


def _pairs(qp: ContactQP) -> tuple[Indices, Indices]:
    """Columns (1, μ_I) and (1, −μ_I) of the same normals."""
    first = np.flatnonzero(qp.feature[:, 4] == 2)
    return first, first + 1
