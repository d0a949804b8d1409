"""How optimal an answer can be in float64, derived from the data of the QP.

With columns of length 1, z = ‖a‖ x and g = Δ/‖a‖, and u the unit roundoff, evaluating r = A x + d
costs (k + 1) u (|A||x| + |d|) in each entry, and each g_j then another m u ‖r‖.  So no method knows
a sign of g better than

    noise = (m + k + 1) u ‖ |A||x| + |d| ‖.

The residuals below are taken in extended precision from the data, not from what a solver says.
"""

from __future__ import annotations

import numpy as np

from problems.qp import ContactQP, Solution, Status, Vector

UNIT_ROUNDOFF = 0.5 * float(np.finfo(np.float64).eps)
RANK_TOL = 1e-10
OUT_OF_PROPORTION = 0.99e4
"""‖ |A||x| + |d| ‖, in units of ‖d‖: a little below `tolerances.OUT_OF_PROPORTION`."""


def column_lengths(qp: ContactQP) -> Vector:
    """‖a_j‖, 1 for a column of zeros.  (k,)"""
    norms = np.linalg.norm(qp.dense_A, axis=0)
    return np.where(norms > 0, norms, 1.0)


def size_of_terms(qp: ContactQP, x: Vector) -> float:
    """‖ |A||x| + |d| ‖."""
    return float(np.linalg.norm(np.abs(qp.dense_A) @ np.abs(x) + np.abs(qp.d)))


def noise(qp: ContactQP, x: Vector) -> float:
    """What rounding does to the g of unit columns."""
    return (qp.m + qp.k + 1) * UNIT_ROUNDOFF * size_of_terms(qp, x)


def is_out_of_proportion(qp: ContactQP, x: Vector) -> bool:
    """Whether x is as large as where columns differ by little more than rounding."""
    return size_of_terms(qp, x) > OUT_OF_PROPORTION * float(np.linalg.norm(qp.d))


def wrong_sign(qp: ContactQP, x: Vector) -> float:
    """Largest g of the wrong sign: |g| between the bounds, −g at a lower, g at an upper one."""
    A, wide = qp.dense_A.astype(np.longdouble), x.astype(np.longdouble)
    g = (A.T @ (A @ wide + qp.d)) / column_lengths(qp)
    wrong = np.maximum(np.where(x < qp.upper, -g, 0.0), np.where(x > qp.lower, g, 0.0))
    return float(wrong.max(initial=0.0))


def sign_tolerance(qp: ContactQP, x: Vector, eps0: float) -> float:
    """ε₁ ≤ ε₀ where ε₀ can be had, else a few times the noise: r and g are each taken twice."""
    return max(eps0, 4.0 * noise(qp, x))


def force_tolerance(qp: ContactQP, x: Vector, other: Vector, eps0: float) -> float:
    """Distance in A x of two answers whose signs are each right to `sign_tolerance`.

    With e = B(z − z'), T the rows where z and z' differ and δ, δ' their sign errors,

        ‖e‖² = Σ_T (g − g')_j (z − z')_j ≤ (δ + δ') ‖z − z'‖₁ ≤ (δ + δ') √|T| ‖e‖ / σ_min(B_T),

    since g_j has the right sign for a move from z_j to z'_j, and g'_j for the way back.  Where B_T
    lacks rank the smallest singular value that is not 0 stands for σ_min.
    """
    T = x != other
    sigma = np.linalg.svd((qp.dense_A / column_lengths(qp))[:, T], compute_uv=False)
    sigma = sigma[sigma > RANK_TOL * sigma.max(initial=0.0)]
    if sigma.size == 0:
        return eps0
    both = sign_tolerance(qp, x, eps0) + sign_tolerance(qp, other, eps0)
    return eps0 + both * float(np.sqrt(T.sum())) / float(sigma[-1])


def assert_solved(
    qp: ContactQP, solution: Solution, eps0: float, *, dependent: bool = False
) -> Vector:
    """The method ended by itself, within the bounds, with every sign right; returns x.

    dependent : columns may be, to rounding; an x out of all proportion may be called inaccurate
    """
    x = solution.x
    assert x is not None and x.shape == (qp.k,)
    doubt = dependent and is_out_of_proportion(qp, x)
    ended = {Status.SOLVED} | ({Status.INACCURATE} if doubt else set())
    assert solution.status in ended, f"{solution.status.name}: {solution.status_text}"
    assert ((qp.lower <= x) & (x <= qp.upper)).all(), "x is out of its bounds"
    wrong, allowed = wrong_sign(qp, x), sign_tolerance(qp, x, eps0)
    assert wrong <= allowed, f"a gradient is wrong by {wrong:.2e} > {allowed:.2e}"
    return x


def assert_same(qp: ContactQP, x: Vector, other: Vector, eps0: float) -> None:
    """A x of two answers to the same QP is the same."""
    error = float(np.linalg.norm(qp.A @ (x - other)))
    allowed = force_tolerance(qp, x, other, eps0)
    assert error <= allowed, f"A x differs by {error:.2e} > {allowed:.2e}"
