"""The paper's method: an active-set method for min ½‖A x + d‖², lower ≤ x ≤ upper.

Lötstedt 1984, §3.2, algorithm 2, for bounds on both sides (§4.2) and columns scaled to length 1
(see `start`).  Every variable is in one of three sets: F, free, whose columns A_F are independent
and have a QR factorization; X, at a bound; P, passive: between its bounds, its column dependent on
A_F, its x kept as it is.  Contacts that share a load redundantly make P.

    1.  F, its R and a feasible x from the previous QP, or cold                         (`start`)
    2.  r = A x + d
    3.  descent direction: A_Fᵀ A_F p + A_Fᵀ r = 0                                        (3.19)
    4.  the longest step θ p, 0 ≤ θ ≤ 1, within the bounds
    5.  x := x + θ p on F, and r anew
    6.  each x_j that reached a bound moves from F to X, its column leaves the QR; back to 3
    7.  gradient Δ = Aᵀ r
    8.  the worst wrong sign over X, |Δ_j| over P: if it exceeds ε₁, j moves to F; back to 3
    9.  end

Most QPs end after one descent direction, because F of the previous step is right.

R is the previous step's where there is one, and (3.19) is solved by conjugate gradients that it
preconditions (`conjugate_gradients`), to ‖v‖ ≤ ε₀/‖R⁻¹‖ (3.20).  Where the iterations would exceed
(2 C_QR/C_IT)^½, A_F is factorized anew at once.  Impulses work with exact Q and R.

This differs from the paper:

1. ε₀ is divided by 10 in (3.20) and in ε₁, so that sign errors, the error of p and the estimate of
   ‖R⁻¹‖, which is from below, together stay under ε₀.  Both tolerances are floored at the rounding
   of Δ, 4u‖|A||x| + |d|‖.
2. r is computed afresh in step 5, so that rounding does not gather.  Where ‖A_Fᵀ r‖ after a full
   step is still above (3.20), step 3 is repeated with the same F: refinement, not counted as
   another descent direction.
3. A passive variable at one of its bounds is tested like a member of X: an entry that could only
   be blocked at once is not tried.
4. A Δ_j below ε₁ is not enough to end: a column close to the span of A_F moves A x far on a
   small Δ_j.  Where one has the wrong sign beyond rounding, the move of A x that freeing x_j would
   give is computed, and compared with ε₀ (`worth_freeing`).
5. A variable that enters and is thrown back before A x has moved, and one whose column depends on
   A_F, are barred until A x moves (or F loses a column).  Each pass then lowers the objective,
   shrinks F or bars a variable, so that rounding cannot make it cycle.  In exact arithmetic neither
   happens: after step 7 A_Fᵀ r = 0, so that an entering variable moves off its bound, and
   a_j = A_F w gives Δ_j = wᵀ A_Fᵀ r = 0.
6. Where conjugate gradients fail although R is today's, or would end with a wrong sign that
   matters, the QP is finished with exact Q and R.  That is met with columns within 1e-6 of
   dependence, not in the paper's scenes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE, ContactQP, Status, Vector
from solvers.active_set.flops import (
    cg_iteration_flops,
    cg_limit,
    estimate_flops,
    product_flops,
    qr_flops,
    triangular_flops,
)
from solvers.base import Answer, Form, Solver, Start
from tests.solvers.numpy_twin.conjugate_gradients import conjugate_gradients, solve_R
from tests.solvers.numpy_twin.factorization import (
    UNIT_ROUNDOFF,
    Factorization,
    Positions,
    qr_delete,
    qr_factorize,
    qr_insert,
)
from tests.solvers.numpy_twin.start import (
    ScaledQP,
    carry_factorization,
    free_rows,
    initial_point,
    scale_qp,
)
from tests.solvers.numpy_twin.tally import Tally

SHARE = 0.1
"""Part of ε₀ that the direction and the signs may each take."""
ROUNDING = 4 * UNIT_ROUNDOFF
EXACT_KINDS = ("impulse", "minimum_norm")
VARIANTS = {
    "": "the paper's method: the previous working set, conjugate gradients with the old R",
    "exact_qr": "a fresh QR factorization of the previous working set at every QP",
    "no_working_set": "the previous x, but F chosen and factorized anew at every QP",
    "plain_cg": "conjugate gradients without R, which only tells ranks and tolerances",
}


class Native(NamedTuple):
    """What `Lotstedt.setup` hands to `Lotstedt.run`."""

    problem: ScaledQP
    start: Start | None


class Result(NamedTuple):
    """What `Lotstedt.run` hands to `Lotstedt.read`."""

    z: Vector
    R: Factorization
    tally: Tally
    status: Status
    status_text: str


@dataclass(frozen=True)
class Lotstedt(Solver):
    """Active set by Lötstedt's algorithm 2, conjugate gradients with the previous R.

    variant : one of `VARIANTS`
    interval : factorize anew every so many QPs, instead of by the criterion; 0: by the criterion
    cg_limit : a direction whose iterations would exceed it calls for a new factorization; None: the
        paper's (2 C_QR/C_IT)^½
    iteration_limit : passes of the main loop before giving up; None: 50 + 20 k
    """

    variant: str = ""
    interval: int = 0
    cg_limit: float | None = None
    iteration_limit: int | None = None

    name: ClassVar[str] = "lotstedt"
    form: ClassVar[Form] = "least_squares"
    warm_start: ClassVar[str] = "working set and factorisation"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.variant not in VARIANTS:
            known = ", ".join(name or '""' for name in VARIANTS)
            raise ValueError(f"lotstedt has no variant {self.variant!r}; it has: {known}")
        if self.interval < 0:
            raise ValueError(f"interval = {self.interval}; give a number of QPs, or 0")
        for option in ("cg_limit", "iteration_limit"):
            value = getattr(self, option)
            if value is not None and not value >= 0:
                raise ValueError(f"{option} = {value!r}; give a number ≥ 0, or None")

    def build(self, qp: ContactQP, start: Start | None) -> ContactQP:
        """Nothing: A and d are the method's own form."""
        return qp

    def setup(self, problem: ContactQP, asked: float | None, start: Start | None) -> Native:
        """Lay out the columns of A one after the other, at length 1."""
        exact = problem.kind in EXACT_KINDS or self.variant == "exact_qr"
        return Native(scale_qp(problem, asked, exact), start)

    def run(self, native: Native) -> Result:
        """Algorithm 2."""
        return algorithm_2(native.problem, native.start, self)

    def read(self, qp: ContactQP, native: Native, result: Result) -> Answer:
        """x in the units of the QP, exactly at its bounds where z is; F, X and P."""
        problem, z = native.problem, result.z
        result.R.R.setflags(write=False)
        at_lower, at_upper = z <= problem.lower, z >= problem.upper
        x = np.clip(z / problem.lengths, qp.lower, qp.upper)
        x[at_upper] = qp.upper[at_upper]
        x[at_lower] = qp.lower[at_lower]
        members = np.full(qp.k, PASSIVE, dtype=np.int8)
        members[at_upper] = AT_UPPER
        members[at_lower] = AT_LOWER
        members[result.R.columns] = FREE
        return Answer(
            x=x,
            status=result.status,
            iterations=result.tally.descent_directions,
            status_text=result.status_text,
            working_set=members,
            work=result.tally.counts(),
            memory=replace(result.R, Q=None, age=result.R.age + 1),
        )


def algorithm_2(problem: ScaledQP, start: Start | None, options: Lotstedt) -> Result:
    """Algorithm 2 with the step numbers of the module's docstring; nothing given is modified."""
    B, d, lower, upper = problem.B, problem.d, problem.lower, problem.upper
    m, k = B.shape
    tally = Tally()
    z = initial_point(problem, start)
    R = initial_factorization(problem, start, options, tally)  # 1.
    r = B @ z + d  # 2.
    tally.flops += product_flops(m, k)
    absolute_B, absolute_d = np.abs(B), np.abs(d)
    entered, bounced, dismissed = np.zeros((3, k), dtype=bool)
    passes = 50 + 20 * k if options.iteration_limit is None else options.iteration_limit
    refining = inf  # ‖A_Fᵀ r‖ before a full step on the same F; inf where F has changed
    demanded = False

    while True:
        gradient = r @ B  # 7., and the right-hand side of 3.
        size = sqrt(np.sum((absolute_B @ np.abs(z) + absolute_d) ** 2))
        tally.flops += 2 * product_flops(m, k)
        F = R.columns
        rounding = ROUNDING * size
        aim = max(SHARE * problem.eps0 / R.inverse_norm, rounding)  # (3.20) and ε₁
        slope = sqrt(gradient[F] @ gradient[F])
        # a slope that refinement does not halve is rounding
        if demanded or (slope > max(aim, rounding * sqrt(F.size)) and slope < 0.5 * refining):
            demanded = False
            if passes <= 0:
                break
            passes -= 1
            tally.descent_directions += refining == inf
            R, p = descent_direction(problem, R, r, 0.5 * aim, options, tally)  # 3.
            F = R.columns
            theta, reached = ratio_test(z[F], p, lower[F], upper[F])  # 4.
            z[F] += theta * p  # 5.
            z[F[reached]] = np.where(p > 0, upper[F], lower[F])[reached]
            before, r = r, B @ z + d
            tally.flops += product_flops(m, k)
            refining = slope if theta == 1.0 else inf
            moved = r - before
            if sqrt(moved @ moved) > rounding:
                entered[:] = bounced[:] = dismissed[:] = False
            if reached.any():  # 6.
                bounced[F[reached]] |= entered[F[reached]]
                dismissed[:] = False
                R = delete_columns(R, np.flatnonzero(reached), tally)
                refining = inf
            continue
        wrong = wrong_signs(gradient, z, problem)  # 8.
        left = max(slope, float(wrong.max(initial=0.0)))
        wrong[F] = 0.0
        wrong[bounced | dismissed] = 0.0
        if wrong.max(initial=0.0) <= rounding:  # 9.
            exact = R.Q is not None and (refining < inf or F.size == 0)
            passable = 2 if R.Q is None else 100
            sound = left <= max(SHARE * problem.eps0, passable * rounding)
            if sound or exact:
                status = Status.SOLVED if sound else Status.INACCURATE
                return Result(z, R, tally, status, f"largest wrong gradient {left:.1e}")
            # rows are barred that should move: A_Fᵀ r is at rounding, but where A_F is nearly
            # dependent r is not yet.  A full step by today's Q and R makes r itself small
            if R.Q is None:
                R = factorize(problem, F, True, tally)
            refining, demanded = inf, R.columns.size > 0
            bounced[:] = dismissed[:] = False
            continue
        if passes <= 0:
            break
        passes -= 1
        j = int(wrong.argmax())
        grown = insert_column(problem, R, j, tally)
        if grown is None or not (
            wrong[j] > aim or worth_freeing(grown, gradient, SHARE * problem.eps0, rounding)
        ):
            dismissed[j] = True
        else:
            R, entered[j], refining = grown, True, inf
            tally.working_set_changes += 1
    return Result(z, R, tally, Status.ITERATION_LIMIT, f"{tally.descent_directions} directions")


def initial_factorization(
    problem: ScaledQP, start: Start | None, options: Lotstedt, tally: Tally
) -> Factorization:
    """Step 1: the old R brought to today's free rows, or a fresh factorization of them."""
    cold_set = start is None or options.variant == "no_working_set"
    free = free_rows(problem, None if cold_set else start)
    if start is not None and not cold_set and not problem.exact:
        R = carry_factorization(problem, start, free, tally, options.interval or inf)
        if R is not None:
            return R
    return factorize(problem, free, problem.exact, tally)


def factorize(problem: ScaledQP, columns: Positions, keep_Q: bool, tally: Tally) -> Factorization:
    """Fresh factorization of the independent ones among `columns`, counted."""
    R = qr_factorize(problem.B, columns, keep_Q)
    if columns.size:
        tally.qr_factorizations += 1
        tally.flops += qr_flops(problem.d.size, int(columns.size), keep_Q)
        tally.flops += estimate_flops(R.order)
    return R


def descent_direction(
    problem: ScaledQP,
    R: Factorization,
    r: Vector,
    tolerance: float,
    options: Lotstedt,
    tally: Tally,
) -> tuple[Factorization, Vector]:
    """Step 3: p with ‖A_Fᵀ(A_F p + r)‖ ≤ tolerance, and the factorization that it belongs to.

    The factorization is a new one, perhaps of fewer columns, where conjugate gradients with the
    old one took too many iterations; with Q where today's R did not help either.
    """
    m, f = problem.d.size, R.order
    if R.Q is not None:
        tally.flops += product_flops(m, f) + triangular_flops(f)
        return R, -solve_R(R.R, r @ R.Q)
    plain = options.variant == "plain_cg"
    limit = options.cg_limit if options.cg_limit is not None else cg_limit(m, f)
    if plain or R.age == 0 or options.interval:
        limit = patience(f, plain)
    found = conjugate_gradients(
        problem.B[:, R.columns], None if plain else R.R, r, tolerance, limit
    )
    tally.cg_iterations += found.iterations
    tally.flops += found.iterations * cg_iteration_flops(m, f, not plain) + product_flops(m, f)
    if found.converged:
        return R, found.p
    fresh = factorize(problem, R.columns, R.age == 0, tally)
    return descent_direction(problem, fresh, r, tolerance, options, tally)


def patience(f: int, plain: bool = False) -> int:
    """Iterations after which conjugate gradients have failed; exact arithmetic needs f."""
    return 10 * f + 100 if plain else 2 * f + 20


def ratio_test(
    z: Vector, p: Vector, lower: Vector, upper: Vector
) -> tuple[float, NDArray[np.bool_]]:
    """Step 4: θ = min(1, min τ_i) with τ_i the step to the bound ahead, and who reaches it."""
    room = np.where(p > 0, upper - z, z - lower)
    steps = np.full(p.size, inf)
    with np.errstate(over="ignore"):
        np.divide(room, np.abs(p), out=steps, where=p != 0)
    theta = min(1.0, float(steps.min(initial=inf)))
    return theta, steps <= theta


def delete_columns(R: Factorization, positions: Positions, tally: Tally) -> Factorization:
    """Step 6: move columns (by position in R) from F to X, counted."""
    smaller, flops = qr_delete(R, positions)
    tally.working_set_changes += int(positions.size)
    tally.qr_updates += int(positions.size)
    tally.flops += flops
    return smaller


def wrong_signs(gradient: Vector, z: Vector, problem: ScaledQP) -> Vector:
    """Step 8: by how much Δ_i has the wrong sign for where z_i is; |Δ_i| between the bounds."""
    up = np.where(z < problem.upper, -gradient, 0.0)
    down = np.where(z > problem.lower, gradient, 0.0)
    return np.maximum(up, down)


def worth_freeing(grown: Factorization, gradient: Vector, eps0: float, rounding: float) -> bool:
    """Step 8: whether freeing the last column of `grown`, at optimal F, moves A x by over eps0.

    With a_j = A_F w + s, s ⟂ A_F and ρ = ‖s‖, A x moves by |sᵀr|/ρ, sᵀr = Δ_j − wᵀΔ_F.
    """
    R, F, rho = grown.R, grown.columns[:-1], abs(float(grown.R[-1, -1]))
    along, size = float(gradient[grown.columns[-1]]), 1.0
    if F.size:
        w = solve_R(np.asfortranarray(R[:-1, :-1]), R[:-1, -1].copy())
        along, size = along - float(w @ gradient[F]), 1.0 + sqrt(w @ w)
    return abs(along) > max(eps0 * rho, rounding * size)


def insert_column(
    problem: ScaledQP, R: Factorization, j: int, tally: Tally
) -> Factorization | None:
    """Step 8: the factorization with column j appended, counted; None where it depends on A_F.

    Where conjugate gradients do not find the column of R, A_F is factorized anew, with Q.
    """
    try:
        grown, iterations, flops = qr_insert(R, problem.B, j, patience(R.order))
    except ArithmeticError:
        R = factorize(problem, R.columns, True, tally)
        grown, iterations, flops = qr_insert(R, problem.B, j, 0)
    tally.cg_iterations += iterations
    tally.qr_updates += 1
    tally.flops += flops
    return grown
