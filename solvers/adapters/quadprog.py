"""quadprog, the dual active-set method of Goldfarb and Idnani (1983) in C.

It wants a definite Hessian.  Where P = AᵀA is one, the problem is posed in normal form, with one
row for each finite bound.  quadprog does not say how near to singular P is: building looks at the
pivots of P.  Elsewhere the velocity problem (3.4) is posed:

    minimise ½‖r − c‖²   subject to   Bᵀ r ≥ 0,

where x = base + σ x′, x′ ≥ 0 counts from the finite bound (σ = −1 from an upper one), B = A σ and
c = d + A base; rows without bounds are equalities.  x′ are the multipliers.

A row with both bounds, 0 ≤ x′ ≤ w, may have Δ′ < 0 at the cost w: a slack s ≥ −Δ′, s ≥ 0, with w s
in the objective.  That slack has no curvature.  It is given ½‖(s − s_j)/ρ‖², ρ = 30, and the
problem is solved again from s_{j+1} = s until s stands still: proximal iterations, each a thousand
times nearer, of which nothing is left.  r is taken in an orthonormal basis U of the range of A
there, so that it has no part that no contact can change, which would drown the slacks.

Accuracy: an active-set method is exact once it has the working set; quadprog has no tolerance, no
settings and no warm start.  Of rows that depend on each other it may find one violated by rounding
and call the constraints inconsistent: Bᵀr ≥ −1e-14 ‖c‖ prevents it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
import quadprog

from problems.qp import Status, Vector
from solvers.adapters.normal_form import is_definite
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.adapters.programs import OneSided, one_sided
from solvers.base import Form, Start

_SLACK = 30.0  # ρ
_ENOUGH = 1e-14  # by which x′ of the rows at w may miss it, relative to the force
_RELAXED = 1e-14
_SINGULAR = 1e-4
"""Least entry on the diagonal of R over the largest, above which P is definite enough."""
_MAX_PASSES = 20


class _Slacked(NamedTuple):
    """The velocity problem: I, a, C, b, numbers of equations and of r, and how x′ is counted."""

    identity: Vector
    a: Vector
    C: Vector
    b: Vector
    equations: int
    m: int
    own: OneSided


@dataclass(frozen=True)
class Quadprog(PackageSolver):
    """quadprog: dual active-set method, on P = AᵀA or on the velocity problem; no warm start."""

    name: ClassVar[str] = "quadprog"
    package: ClassVar[str] = "quadprog"
    form: ClassVar[Form] = "normal"
    regularisation: ClassVar[str] = "none left: proximal iterations on slacks of two-sided rows"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "constraints are inconsistent, no solution": Status.INFEASIBLE,
    }

    def arrays(self, posed: Posed) -> Any:
        """P, a, C and b of the normal form; the velocity problem where P is singular."""
        if posed.n > posed.m or not is_definite(posed.P, _SINGULAR):
            return _slacked(posed)
        if posed.one_sided:
            return posed.P, -posed.q, _identity(posed.n), posed.lower.copy()
        low, high = np.flatnonzero(posed.lower > -np.inf), np.flatnonzero(posed.upper < np.inf)
        if not low.size + high.size:
            return _slacked(posed)  # with equations alone: quadprog wants a row
        rows = _identity(posed.n)
        C = np.hstack([rows[:, low], -rows[:, high]])
        return posed.P, -posed.q, C, np.concatenate([posed.lower[low], -posed.upper[high]])

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing: all of it is one call."""
        return Native(problem.posed, None, problem.arrays)

    def run(self, native: Native) -> Any:
        """`quadprog.solve_qp`, again until the slacks have settled."""
        try:
            if isinstance(native.arrays, _Slacked):
                return _settled(native.arrays)
            return quadprog.solve_qp(*native.arrays)
        except ValueError as error:  # quadprog's only way to say that it failed
            return str(error)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """x, or x′ from the multipliers of the velocity problem."""
        if isinstance(result, str):
            return Outcome(None, result)
        if isinstance(native.arrays, _Slacked):
            multipliers, iterations = result
            x = native.arrays.own.x(multipliers[: native.posed.n])
            return Outcome(x, "solved", iterations)
        x, _, _, counts, *_ = result
        return Outcome(x, "solved", int(counts[0]))


def _settled(problem: _Slacked) -> tuple[Vector, int]:
    """Multipliers and iterations of the velocity problem, once its slacks stand still."""
    identity, a, C, b, equations, m, _ = problem
    now, slack, iterations = a, np.zeros(a.size - m), 0
    for _ in range(_MAX_PASSES):
        r, _, _, counts, multipliers, _ = quadprog.solve_qp(identity, now, C, b, equations, True)
        iterations += int(counts[0])
        moved = np.abs(r[m:] - slack).max(initial=0.0)
        if moved <= _ENOUGH * _SLACK:
            break
        slack = r[m:]
        now = np.concatenate([a[:m], a[m:] + slack])
    return multipliers, iterations


def _slacked(posed: Posed) -> _Slacked:
    """The velocity problem, unknowns (r, s/ρ)."""
    own = one_sided(posed)
    t = own.two.size
    A, d = posed.reduced if t else (posed.dense, posed.d)
    m, n = A.shape
    C = np.zeros((m + t, n + t))
    C[:m, :n] = (A * own.sign)[:, own.order]
    C[m + np.arange(t), own.two] = _SLACK
    C[m + np.arange(t), n + np.arange(t)] = 1.0
    c = d + A @ own.base
    b = np.zeros(n + t)
    b[own.equations : n] = -_RELAXED * max(posed.force, float(np.linalg.norm(c)))
    a = np.concatenate([c, -_SLACK * own.width])
    return _Slacked(np.identity(a.size), a, C, b, own.equations, m, own)


@lru_cache(64)
def _identity(n: int) -> Vector:
    return np.identity(n)
