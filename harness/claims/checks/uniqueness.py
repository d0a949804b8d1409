"""Proposition 1: one q̇_n and λ_n where f depends on q̇ and (3.7) holds.

q̇ = u(λ):  α₀ q̇ = h M⁻¹(f(q̇) + G λ) + b,     λ ≥ 0,  Gᵀu(λ) ≥ 0,  λᵀGᵀu(λ) = 0        (3.8)
"""

from __future__ import annotations

from itertools import product

import numpy as np

from harness.claims.checking import check
from problems.qp import Vector

ROWS, COLUMNS = 9, 4
"""Three bodies, four contacts."""
STEPS = 200
"""Of Newton's method."""


class _Case:
    """Masses, columns and b, drawn; h = 0.1, α₀ = 3/2."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.rng, self.h, self.alpha0 = rng, 0.1, 1.5
        self.M = rng.uniform(0.5, 2.0, ROWS)
        self.G = rng.standard_normal((ROWS, COLUMNS))
        self.b = rng.standard_normal(ROWS)


@check
def many_starts(drag: float, starts: int = 60) -> float:
    """Largest distance of the q̇ that Newton's method finds from random starts, relative; ∞: none.

    f = −drag q̇|q̇|, entry by entry, which damps where drag > 0.
    """
    worst = 0.0
    for seed in range(5):
        case = _Case(seed)
        found = [v for _ in range(starts) if (v := _newton(case, drag)) is not None]
        if len(found) < starts // 4:
            return np.inf
        apart = np.linalg.norm(np.array(found) - found[0], axis=1).max()
        worst = max(worst, float(apart / np.linalg.norm(found[0])))
    return worst


def _newton(case: _Case, drag: float) -> Vector | None:
    """A solution of (3.1b), (3.1c) with Fischer and Burmeister's function, or None."""
    v = 3.0 * case.rng.standard_normal(ROWS)
    lam = 30.0 * case.rng.uniform(size=COLUMNS)
    for _ in range(STEPS):
        gap = case.G.T @ v
        size = np.sqrt(gap**2 + lam**2) + 1e-300
        F = np.concatenate([
            case.alpha0 * case.M * v + case.h * (drag * v * np.abs(v) - case.G @ lam)
            - case.M * case.b,
            size - gap - lam,
        ])  # fmt: skip
        norm = np.linalg.norm(F)
        if norm < 1e-12:
            return np.asarray(v)
        J = np.block([
            [np.diag(case.alpha0 * case.M + 2 * case.h * drag * np.abs(v)), -case.h * case.G],
            [(gap / size - 1)[:, None] * case.G.T, np.diag(lam / size - 1)],
        ])  # fmt: skip
        move = np.linalg.lstsq(J, -F, rcond=None)[0]
        length = min(1.0, 10.0 / float(np.abs(move).max()))
        v, lam = v + length * move[:ROWS], lam + length * move[ROWS:]
    return None


@check
def share_unique(kappa: float, trials: int = 200) -> float:
    """Share of random steps with exactly one q̇, by trying all 2⁴ sets of λ_i = 0.

    f = C q̇ with a symmetric C whose largest h λ_i/α₀ of D⁻ᵀ C D⁻¹ is `kappa`; below 1 the remark on
    (3.7) says one, and beyond A is indefinite: an anti-damper.
    """
    unique = 0
    for seed in range(trials):
        case = _Case(seed)
        Q, _ = np.linalg.qr(case.rng.standard_normal((ROWS, ROWS)))
        values = np.append(kappa, case.rng.uniform(-3.0, min(kappa, 0.9), ROWS - 1))
        D = np.sqrt(case.M)
        C = case.alpha0 / case.h * D[:, None] * (Q * values) @ Q.T * D
        unique += len(_all_solutions(case, C)) == 1
    return unique / trials


def _all_solutions(case: _Case, C: Vector) -> list[Vector]:
    """Every q̇ that meets (3.1b), (3.1c), each once."""
    A = np.diag(case.alpha0 * case.M) - case.h * C
    free, push = np.linalg.solve(A, case.M * case.b), case.h * np.linalg.solve(A, case.G)
    B, q = case.G.T @ push, case.G.T @ free
    found: list[Vector] = []
    for chosen in product((False, True), repeat=COLUMNS):
        on, lam = np.flatnonzero(chosen), np.zeros(COLUMNS)
        lam[on] = np.linalg.solve(B[np.ix_(on, on)], -q[on])
        if lam.min() >= 0.0 and (np.delete(B @ lam + q, on) >= 0.0).all():
            v = free + push @ lam
            if all(np.linalg.norm(v - other) > 1e-9 for other in found):
                found.append(v)
    return found
