"""Passes: q̇ and λ of a step by (4.5), (4.6), or of an impulse, compiled.

One pass poses the QP (3.2) or (4.6) with the forces at the last guess of q̇ and with λ_*, has it
solved, and reads q̇, q̈ and λ off its answer, which satisfies (3.1c), or (4.7) with friction.  Passes
are repeated

    - (3.9) while f depends on q̇: functional iteration from a predicted q̇_n⁽⁰⁾;
    - with corrected friction, until λ_* agrees with the λ_N that it gives (`friction.newton`);

both in one loop, stopped by (3.14): with ρ the observed rate and δ the change that another pass
would make in ‖q̇_n‖_M, when (ρ δ + (h/α₀) ε₀)/(1 − ρ) ≤ 0.1 ε.  A rate ρ ≥ 1 without friction, or
the cap of passes, ends them in vain.

`fixed_point` is that loop.  A QP is solved by the method handed to it, if it has one; with any
other solver, and for what is not compiled, it returns what it asks for, `ANSWER`, `FORCES` or
`GUESS`, and goes on where it was once that stands in its arrays (`problems.friction.posed`).

This differs from the paper: ε₀ in (3.14) is multiplied by h/α₀, as its derivation gives.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import problems.formulas.multistep as multistep
from problems.contacts.active_kernels import Frictions, friction_bounds
from problems.contacts.geometry_kernels import column_speeds, column_sum
from problems.formulas.multistep import FIRST_RATE
from problems.formulas.step_kernels import momentum, outcome, weighted_norm
from problems.friction.kernels import (
    driven_forces,
    force_change,
    forced_signs,
    small_newton_multipliers,
)
from problems.friction.rules import cones
from problems.kernels.arena import Arena
from problems.kernels.compiled import kernel, stage
from problems.kernels.numba_internals import in_place, lent, read_only
from problems.least_norm.independence import SAFE_FRACTION, far_from_dependent
from problems.least_norm.least_distance import least_norm
from problems.qp import LARGEST, Indices, Vector
from problems.qp_kernel import WARM, X, method_at

iteration_error = kernel(multistep.iteration_error)

MAX_PASSES = 12
STUCK_PASSES = 60
"""Passes from λ_* = ∞: where contacts catch they come down to it by halves.  After `MAX_PASSES` of
them the LCP is asked, where it is not too large."""
STUCK_TOL = 1e-3
"""… and the relative change of the friction forces at which they end: short steps forgive any λ."""
SMALL = 150
"""Constraints up to which elimination in a dense matrix is faster than in a sparse one."""

SETTLED, UNSETTLED, FAILED, ANSWER, FORCES, GUESS = range(6)
"""How passes end: as they should, in vain, or with a QP that is not solved; or what they ask for:
x of the QP, f at the guess of q̇, λ_* of the next pass."""
POSE, READ, GO_ON = range(3)
"""Where they go on: with the next QP, with its answer, with the next guess."""

NOW = np.dtype(
    [
        *((name, np.float64) for name in ("h", "alpha0", "eps0", "tolerance", "before", "rate")),
        *((name, np.int64) for name in ("stage", "number", "most", "solves", "within")),
        *((name, np.int64) for name in ("asks", "corrects", "depends", "redundant")),
        *((name, np.int64) for name in ("stuck", "next_only", "supplied")),
    ],
    align=True,
)
"""Where passes are.

h, alpha0 : of (3.1b);  eps0 : accuracy of a QP;  tolerance : change of ‖q̇‖_M that others may make
before, rate : the change by the last pass, and ρ
stage : `POSE`, `READ` or `GO_ON`;  number, most : of passes;  solves : QPs
within : whether d is a vector of numbers of a sound size
asks : whether QPs are asked for;  corrects, depends : whether λ_* is corrected, f depends on q̇
redundant : whether A may lack full column rank;  stuck : whether λ_* = ∞ was the first
next_only : whether it is the next pass that counts, and not all further ones by (3.14)
supplied : whether λ_* of the next pass has been given
"""


class Passes(NamedTuple):
    """What passes work with, for m coordinates, k columns, N normals and F frictions.

    frictions : the columns of the QP;  D, b, forces : (m,) of M = DᵀD, (3.1b), f
    lean : (m,) what is added to q̇, which the QP is not to know of (`stepping.drift`)
    guess : (m,) q̇ that f is of;  lam_star : (N,)
    normals, columns, tangents : (entries (·, 6), bodies (·, 2)) of g_N, the QP's columns and g_F
    A, d, lower, upper : the QP; A (0, 0) where QPs are asked for
    x, least : (k,) its answer, and that or the multipliers of least norm with the same A x
    v, a, lam_N, lam_F, bound : q̇, q̈ (m,), λ_N (N,), λ_F and μ Σ λ_* (F,) of the last pass
    now : (1,) `NOW`;  arena : for what is made within a pass
    """

    frictions: Frictions
    D: Vector
    inverse_mass: Vector
    b: Vector
    forces: Vector
    lean: Vector
    guess: Vector
    lam_star: Vector
    normals: tuple[Vector, Indices]
    columns: tuple[Vector, Indices]
    tangents: tuple[Vector, Indices]
    A: Vector
    d: Vector
    lower: Vector
    upper: Vector
    x: Vector
    least: Vector
    v: Vector
    a: Vector
    lam_N: Vector
    lam_F: Vector
    bound: Vector
    now: NDArray[np.void]
    arena: Arena

    @classmethod
    def of(cls, frictions: Frictions, D: Vector, asks: bool, arena: Arena) -> Passes:
        """Room for them; columns, b and the like are written to it."""
        m, k, N, F = D.size, frictions.row.size, frictions.friction_of.size, frictions.mu.size
        of_motion, of_column, of_normal, of_friction = (
            iter(np.zeros((count, size))) for count, size in ((7, m), (3, k), (2, N), (2, F))
        )
        normals, columns, tangents = (
            (np.zeros((count, 6)), np.zeros((count, 2), np.int64)) for count in (N, k, F)
        )
        return cls(
            frictions=frictions,
            D=D,
            inverse_mass=1 / D**2,
            b=next(of_motion),
            forces=next(of_motion),
            lean=next(of_motion),
            guess=next(of_motion),
            lam_star=next(of_normal),
            normals=normals,
            columns=normals if k == N else columns,  # normals alone are in the order of row_id
            tangents=tangents,
            A=np.zeros((0, 0) if asks else (m, k)),
            d=next(of_motion),
            lower=next(of_column),
            upper=np.full(k, np.inf),
            x=next(of_column),
            least=next(of_column),
            v=next(of_motion),
            a=next(of_motion),
            lam_N=next(of_normal),
            lam_F=next(of_friction),
            bound=next(of_friction),
            now=np.zeros(1, NOW),
            arena=arena,
        )


@stage
def pose(p):
    """The QP of the next pass: d by f and the sliding forces s μ Σ λ_*, the bounds ± μ Σ λ_*."""
    now, frictions, arena = p.now[0], p.frictions, p.arena
    now.number += 1
    force = p.forces
    if p.bound.size > 0:
        p.bound[:] = friction_bounds(frictions.friction_of, frictions.mu, p.lam_star, arena)
        p.lam_F[:] = driven_forces(frictions.signs, p.bound, arena)
        force = column_sum(p.tangents[0], p.tangents[1], p.lam_F, p.D.size, arena)
        for i in range(force.size):
            force[i] = p.forces[i] + force[i]
        for s in range(frictions.sticking.size):
            c, bound = frictions.sticking_column[s], p.bound[frictions.sticking[s]]
            p.lower[c], p.upper[c] = -bound, bound
    now.within = 1 if momentum(p.b, force, p.D, now.h, LARGEST, p.d)[1] else 0


@stage
def solve_posed(p, solve, S, I, eps0, mode):
    """Whether the QP is solved by the method, and `mode` for the next one; x and λ are there."""
    now, frictions, arena, k = p.now[0], p.frictions, p.arena, p.x.size
    if now.within == 0:
        return False, mode
    if now.number == 1:
        safe = p.bound.size == 0 or far_from_dependent(p.A, SAFE_FRACTION, arena)
        now.redundant = 0 if safe else 1
    if k > 0:  # (3.2), (4.6)
        solved = method_at(solve)(
            *(read_only(p.A), read_only(p.d), read_only(p.lower), read_only(p.upper)),
            *(read_only(frictions.row_id), S, I, eps0, mode),
        )
        mode |= WARM
        now.solves += 1
        if not solved:
            return False, mode
    for c in range(k):
        p.x[c] = p.least[c] = S[X, c]
    if now.redundant > 0:
        C = cones(frictions) if now.corrects > 0 else np.zeros((0, k))
        least, more = least_norm(
            *(read_only(p.A), read_only(p.lower), read_only(p.upper), read_only(p.x)),
            *(C, arena, solve, mode),
        )
        now.solves += more
        p.least[:] = least
    return True, mode


@stage
def read(p):
    """q̇, q̈ and λ from the answer."""
    now, frictions = p.now[0], p.frictions
    outcome(*p.columns, p.x, p.b, p.d, p.D, now.h, now.alpha0, p.v, p.a)
    for i in range(p.v.size):
        p.v[i] += p.lean[i]
    for j in range(p.lam_N.size):
        p.lam_N[j] = p.least[frictions.normal_column[j]]
    for s in range(frictions.sticking.size):
        p.lam_F[frictions.sticking[s]] = p.least[frictions.sticking_column[s]]


@stage
def friction_motion(p, lam_F):
    """‖M⁻¹ G_F λ_F‖_M."""
    force = column_sum(p.tangents[0], p.tangents[1], lam_F, p.D.size, p.arena)
    for i in range(force.size):
        force[i] *= p.inverse_mass[i]
    return weighted_norm(p.D, force)


@stage
def settles(p):
    """(3.14): whether further passes would change q̇ by no more than the tolerance."""
    now, frictions = p.now[0], p.frictions
    behind, ahead, loose = 0.0, 0.0, False
    if now.depends > 0:
        behind = weighted_norm(p.D, p.v - p.guess)
    if now.corrects > 0:
        bound = friction_bounds(frictions.friction_of, frictions.mu, p.lam_N, p.arena)
        moved = force_change(frictions.signs, p.lam_F, p.bound, bound, p.arena)
        off = friction_motion(p, moved)
        ahead = now.h / now.alpha0 * off
        # friction forces that are still on their way down from λ_* = ∞
        loose = now.stuck > 0 and off > STUCK_TOL * friction_motion(p, p.lam_F)
    change = behind + ahead
    now.rate = change / now.before if now.number > 1 and now.before > 0.0 else FIRST_RATE
    now.before = change
    left = inf
    if now.next_only > 0:
        left = change
    elif now.rate < 1.0:
        left = iteration_error(now.rate, behind, ahead, now.h / now.alpha0 * now.eps0)
    return left <= now.tolerance and not loose


@stage
def asks_for_guess(p):
    """Whether λ_* of the next pass is too much for `next_guess`, or for Newton's method."""
    now, many = p.now[0], p.lam_N.size + p.bound.size > SMALL
    beyond = many or (now.stuck > 0 and now.number == MAX_PASSES)
    return now.asks > 0 and now.corrects > 0 and now.supplied == 0 and beyond


@stage
def next_guess(p):
    """q̇ that f is of in the next pass, and its λ_* by Newton's method."""
    now, frictions, arena = p.now[0], p.frictions, p.arena
    for i in range(p.guess.size):
        p.guess[i] = p.v[i]
    if now.corrects > 0 and now.supplied == 0:
        slip = column_speeds(p.tangents[0], p.tangents[1], p.v, arena)
        sigma = forced_signs(frictions.signs, p.lam_F, p.bound, slip, arena)
        p.lam_star[:] = small_newton_multipliers(
            *(p.normals, p.tangents, p.inverse_mass, frictions.friction_of, frictions.mu),
            *(frictions.signs, sigma, p.lam_star, p.lam_N, now.stuck > 0),
        )
    now.supplied = 0


@kernel
def fixed_point(p, solve, S, I, eps0, mode):
    """Passes until they settle: how they end, or what they ask for, and `mode` for the next QP.

    p : `Passes`, with `now.stage` = `POSE` at first, and where it stood when it asked
    solve, S, I, eps0, mode : see `problems.qp_kernel`; not used where QPs are asked for
    """
    # what is in a tuple is lent: else it is counted each time who holds it
    p, S, I = in_place(lent(p)), lent(S), lent(I)
    now, used = p.now[0], p.arena.used
    while True:
        used[0], used[1] = 0, 0
        if now.stage == POSE:
            pose(p)
            now.stage = READ
            if now.asks > 0:
                return ANSWER, mode
            solved, mode = solve_posed(p, solve, S, I, eps0, mode)
            if not solved:
                return FAILED, mode
        if now.stage == READ:
            read(p)
            if (now.corrects == 0 and now.depends == 0) or settles(p):
                return SETTLED, mode
            # without friction the fixed point is a contraction, or the step too long
            apart = now.number > 2 and now.rate >= 1.0 and now.corrects == 0
            if apart or now.number == now.most:
                return UNSETTLED, mode
            now.stage = GO_ON
        if asks_for_guess(p):
            return GUESS, mode
        next_guess(p)
        now.stage = POSE
        if now.depends > 0:
            return FORCES, mode
