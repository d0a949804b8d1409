"""Counting the work of algorithm 2: floating-point operations by formula.

The refactorization criterion of Lötstedt 1984, §3.2, weighs C_QR, the cost of a factorization,
against C_IT, the cost of one conjugate gradient iteration.  Both are counted here, in operations
(an addition or a multiplication is one), leading terms only, for A_F dense with m rows and f
columns.  Counts are exact functions of the sizes, so that two runs on any machine agree.
"""

from __future__ import annotations

from math import sqrt

from solvers.active_set.compiled import kernel


@kernel
def product_flops(m: int, k: int) -> int:
    """A x or Aᵀ r for A (m, k)."""
    return 2 * m * k


@kernel
def triangular_flops(f: int) -> int:
    """Solve with a triangular R of order f."""
    return f * f


@kernel
def qr_flops(m: int, f: int, keep_Q: bool = False) -> int:
    """C_QR: pivoted Householder QR of f columns (Businger and Golub 1965), 2 f²(m − f/3).

    With more columns than rows, f > m, the roles change.  `keep_Q` adds forming the m×f factor Q,
    as much again.
    """
    n, f = (f, m) if f > m else (m, f)
    cost = 2 * f * f * n - (2 * f**3) // 3
    return 2 * cost if keep_Q else cost


@kernel
def cg_iteration_flops(m: int, f: int, preconditioned: bool = True) -> int:
    """C_IT: products with A_F and A_Fᵀ, solves with R and Rᵀ, and the vectors."""
    return 4 * m * f + (2 * f * f if preconditioned else 0) + 4 * m + 6 * f


@kernel
def insert_flops(m: int, f: int, keep_Q: bool) -> int:
    """Append a column to f others: Gram-Schmidt twice against Q, or w → R w where Q is not kept.

    Without Q the conjugate gradient iterations for w are counted apart.
    """
    return 8 * m * f if keep_Q else triangular_flops(f)


@kernel
def delete_flops(m: int, f: int, position: int, keep_Q: bool) -> int:
    """Remove the column at `position` of f by Givens rotations: 6 for each pair of entries."""
    rotations = f - 1 - position
    return 3 * rotations * (rotations + 1) + (6 * m * rotations if keep_Q else 0)


@kernel
def estimate_flops(f: int) -> int:
    """Estimate of ‖R⁻¹‖ (Cline et al. 1979): one solve with look-ahead and one plain solve."""
    return 4 * f * f


@kernel
def cg_limit(m: int, f: int) -> float:
    """(2 C_QR/C_IT)^½: a direction whose iterations exceed it calls for a new factorization."""
    return sqrt(2 * qr_flops(m, f) / cg_iteration_flops(m, f)) if f else 0.0
