"""Seeded quadratic programs built back from a known solution.

Random data give random problems, whose answer only another solver can tell.  Here the answer is
chosen first (as DAQP's and quadprog's tests do):

1. choose A, the bounds and x*, each entry free, at its lower or at its upper bound;
2. choose the residual r orthogonal to the free columns (and to those that shall be degenerate), so
   that the gradient Δ = Aᵀr vanishes there;
3. turn the columns at a bound whose Δ has the wrong sign, so that Δ ≥ 0 at a lower and Δ ≤ 0 at an
   upper bound;
4. set d = r − A x*.  Then x* meets the KKT conditions of min ½‖A x + d‖², lower ≤ x ≤ upper, to
   rounding, and A x* is its unique force even where x* is one answer of many (proposition 3).

Every generator takes a `numpy.random.Generator` and returns (qp, Ax_star).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import ContactQP, Vector

Case = tuple[ContactQP, Vector]
Flags = NDArray[np.bool_]
INF = np.inf


def from_solution(
    A: Vector,
    x: Vector,
    lower: Vector,
    upper: Vector,
    rng: np.random.Generator,
    *,
    degenerate: Flags | None = None,
    gradient: float = 1.0,
    momentum: float = 0.0,
    sparse: bool = False,
) -> Case:
    """QP whose solution is `x`; columns of A at a bound may be turned to make it so.

    degenerate : (k,) bool   columns at a bound that get Δ = 0
    gradient : size of the part of r that A sees
    momentum : size of the part of r that A does not see; real scenes have it 10 to 40,000 times
        larger than the force, since it holds the whole momentum over h
    """
    A, fixed = A.copy(), lower == upper
    flat = (x > lower) & (x < upper)
    if degenerate is not None:
        flat = flat | degenerate
    norms = np.linalg.norm(A, axis=0)
    unit = A / np.where(norms > 0, norms, 1.0)
    r = gradient * _project_out(unit[:, flat], rng.standard_normal(A.shape[:1]))
    r += momentum * _project_out(unit, rng.standard_normal(A.shape[:1]))
    slope = A.T @ r
    slope[flat] = 0.0
    wrong = ~fixed & (((x <= lower) & (slope < 0)) | ((x >= upper) & (slope > 0)))
    A[:, wrong] *= -1.0
    Ax = A @ x
    stored = sp.csc_array(A) if sparse else A
    return ContactQP(stored, r - Ax, lower, upper), Ax


def _project_out(columns: Vector, r: Vector) -> Vector:
    """`r` less its part in the span of `columns`; twice, so that it is gone to rounding."""
    if columns.shape[1] == 0:
        return r
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    U = U[:, s > 1e-12 * s[0]]
    if U.shape[1] == r.size:
        return np.zeros_like(r)
    for _ in range(2):
        r = r - U @ (U.T @ r)
    return r


def _choose(rng: np.random.Generator, k: int, share_free: float = 0.6) -> Flags:
    return rng.random(k) < share_free


def _one_sided(A: Vector, rng: np.random.Generator, **how: object) -> Case:
    k = A.shape[1]
    x = np.where(_choose(rng, k), rng.uniform(0.1, 2.0, k), 0.0)
    return from_solution(A, x, np.zeros(k), np.full(k, INF), rng, **how)  # type: ignore[arg-type]


def full_rank(rng: np.random.Generator) -> Case:
    """x ≥ 0, columns independent."""
    return _one_sided(rng.standard_normal((12, 7)), rng)


def rank_deficient(rng: np.random.Generator) -> Case:
    """x ≥ 0, 9 columns of rank 5, two of them equal."""
    A = rng.standard_normal((12, 5)) @ rng.standard_normal((5, 9))
    A[:, 8] = A[:, 0]
    return _one_sided(A, rng)


def degenerate(rng: np.random.Generator) -> Case:
    """x ≥ 0; half of the columns at their bound have Δ = 0 as well."""
    k = 8
    x = np.where(_choose(rng, k, 0.4), rng.uniform(0.1, 2.0, k), 0.0)
    weak = (x == 0) & _choose(rng, k, 0.5)
    A = rng.standard_normal((12, k))
    return from_solution(A, x, np.zeros(k), np.full(k, INF), rng, degenerate=weak)


def bilateral(rng: np.random.Generator) -> Case:
    """Some rows unbounded on both sides (joints), the others x ≥ 0."""
    k = 8
    joint = _choose(rng, k, 0.4)
    joint[0] = True
    x = np.where(_choose(rng, k), rng.uniform(0.1, 2.0, k), 0.0)
    x[joint] = rng.standard_normal(joint.sum())
    lower = np.where(joint, -INF, 0.0)
    return from_solution(rng.standard_normal((11, k)), x, lower, np.full(k, INF), rng)


def upper_only(rng: np.random.Generator) -> Case:
    """lower = −inf, upper finite (plastic bars)."""
    k = 7
    upper = rng.uniform(-1.0, 1.0, k)
    x = np.where(_choose(rng, k), upper - rng.uniform(0.1, 2.0, k), upper)
    return from_solution(rng.standard_normal((10, k)), x, np.full(k, -INF), upper, rng)


def two_sided(rng: np.random.Generator) -> Case:
    """Normals x ≥ 0 and sticking friction −b ≤ x ≤ b (4.6)."""
    k = 10
    friction = np.arange(k) % 2 == 1
    bound = rng.uniform(0.2, 1.0, k)
    lower = np.where(friction, -bound, 0.0)
    upper = np.where(friction, bound, INF)
    inner = np.where(friction, bound * rng.uniform(-0.9, 0.9, k), rng.uniform(0.1, 2.0, k))
    at_upper = friction & _choose(rng, k, 0.5)
    x = np.where(_choose(rng, k, 0.5), inner, np.where(at_upper, upper, lower))
    return from_solution(rng.standard_normal((13, k)), x, lower, upper, rng)


def fixed_rows(rng: np.random.Generator) -> Case:
    """Some rows with lower = upper, one of them at 0, as a friction bound of a resting λ_N is."""
    k = 8
    lower, upper = np.zeros(k), np.full(k, INF)
    x = np.where(_choose(rng, k), rng.uniform(0.1, 2.0, k), 0.0)
    x[1], x[4], x[6] = 0.0, 0.7, -0.3
    for i in (1, 4, 6):
        lower[i] = upper[i] = x[i]
    return from_solution(rng.standard_normal((11, k)), x, lower, upper, rng)


def all_fixed(rng: np.random.Generator) -> Case:
    """Nothing left to choose."""
    x = rng.standard_normal(3)
    return from_solution(rng.standard_normal((6, 3)), x, x, x, rng)


def empty(rng: np.random.Generator) -> Case:
    """No contact at all: k = 0."""
    return _one_sided(np.zeros((6, 0)), rng)


def wide(rng: np.random.Generator) -> Case:
    """More columns than rows, k > m, with fewer free than rows."""
    k = 12
    x = np.where(_choose(rng, k, 0.3), rng.uniform(0.1, 2.0, k), 0.0)
    return from_solution(rng.standard_normal((7, k)), x, np.zeros(k), np.full(k, INF), rng)


def wide_at_rest(rng: np.random.Generator) -> Case:
    """More columns than rows and every body held: r = 0, all rows degenerate or passive."""
    k = 12
    x = np.where(_choose(rng, k, 0.9), rng.uniform(0.1, 2.0, k), 0.0)
    x[:8] += 0.1
    return from_solution(rng.standard_normal((7, k)), x, np.zeros(k), np.full(k, INF), rng)


def zero_column(rng: np.random.Generator) -> Case:
    """A column of A is zero: its x is anything, its force nothing."""
    A = rng.standard_normal((9, 5))
    A[:, 2] = 0.0
    return _one_sided(A, rng)


def badly_scaled(rng: np.random.Generator) -> Case:
    """Columns from 1e-6 to 1e6 in length, each with a force of size 1."""
    k = 8
    size = 10.0 ** rng.uniform(-6, 6, k)
    size[:2] = 1e-6, 1e6
    x = np.where(_choose(rng, k), rng.uniform(0.1, 2.0, k), 0.0) / size
    A = rng.standard_normal((12, k)) * size
    return from_solution(A, x, np.zeros(k), np.full(k, INF), rng)


def sparse_columns(rng: np.random.Generator) -> Case:
    """A stored by columns, a tenth of it nonzero."""
    A = rng.standard_normal((40, 24)) * (rng.random((40, 24)) < 0.1)
    A[np.arange(24), np.arange(24)] += 1.0
    x = np.where(_choose(rng, 24), rng.uniform(0.1, 2.0, 24), 0.0)
    return from_solution(A, x, np.zeros(24), np.full(24, INF), rng, sparse=True)


def tower_columns(boxes: int, friction: bool, rng: np.random.Generator) -> Vector:
    """A = D⁻ᵀG of a tower of boxes 1 wide and 1 high, two contacts per interface.

    (3 boxes, 2 boxes) normals, and with `friction` one tangent per interface between boxes; the
    ground is smooth, so A never sees the momentum along it.  Masses differ by up to a factor of 4.
    """
    mass = rng.uniform(0.5, 2.0, boxes)
    D = np.sqrt(np.column_stack([mass, mass, mass / 6.0])).ravel()
    columns = []
    for i in range(boxes):
        upper, lower = slice(3 * i, 3 * i + 3), slice(3 * i - 3, 3 * i)
        arms = [(-0.5, 1.0), (0.5, 1.0)] + ([(0.5, 0.0)] if friction and i > 0 else [])
        for arm, along in arms:
            g = np.zeros(3 * boxes)
            # normal (0, 1) at (±½, −½) of the upper box; tangent (1, 0) at the same height
            g[upper] = (0.0, 1.0, arm) if along else (1.0, 0.0, arm)
            if i > 0:
                g[lower] = (0.0, -1.0, -arm) if along else (-1.0, 0.0, arm)
            columns.append(g / D)
    return np.column_stack(columns)


def _contact(
    rng: np.random.Generator, size: float, friction: bool, redundant: bool, boxes: int = 0
) -> Case:
    """A tower whose force is about `size` and whose momentum over h is up to 1e3 times larger.

    boxes : 2 to 4 at random where 0
    """
    boxes = boxes or int(rng.integers(2, 5))
    A = tower_columns(boxes, friction, rng)
    if redundant:
        middle = 0.5 * (A[:, [0]] + A[:, [1]])
        A = np.hstack([A, middle, A[:, [1]]])
    k = A.shape[1]
    tangent = (np.arange(k) % 3 == 1) & (np.arange(k) > 1) if friction else np.zeros(k, bool)
    bound = size * rng.uniform(0.1, 1.0, k)
    lower = np.where(tangent, -bound, 0.0)
    upper = np.where(tangent, bound, INF)
    inner = np.where(tangent, bound * rng.uniform(-0.9, 0.9, k), size * rng.uniform(0.1, 2.0, k))
    x = np.where(_choose(rng, k, 0.7), inner, np.where(_choose(rng, k, 0.5), lower, upper))
    x = np.where(np.isfinite(x), x, 0.0)
    weak = ((x == lower) | (x == upper)) & _choose(rng, k, 0.3)
    momentum = size * 10.0 ** rng.uniform(0, 3)
    return from_solution(A, x, lower, upper, rng, degenerate=weak, gradient=size, momentum=momentum)


def contact_small(rng: np.random.Generator) -> Case:
    """Tower with friction, forces of about 10."""
    return _contact(rng, 1e1, friction=True, redundant=False)


def contact_large(rng: np.random.Generator) -> Case:
    """Tower with friction, forces of about 1e6, as after a restart with a tiny h."""
    return _contact(rng, 1e6, friction=True, redundant=False)


def contact_redundant(rng: np.random.Generator) -> Case:
    """Tower without friction and with redundant contacts, forces of about 100, d up to 1e5."""
    return _contact(rng, 1e2, friction=False, redundant=True)


def tower(rng: np.random.Generator) -> Case:
    """Tower of 12 boxes with friction: 35 rows, condition of A about 50."""
    return _contact(rng, 1e2, friction=True, redundant=False, boxes=12)


KINDS: dict[str, Callable[[np.random.Generator], Case]] = {
    make.__name__: make
    for make in (
        full_rank, rank_deficient, degenerate, bilateral, upper_only, two_sided, fixed_rows,
        all_fixed, empty, wide, wide_at_rest, zero_column, badly_scaled, sparse_columns,
        contact_small, contact_large, contact_redundant, tower,
    )
}  # fmt: skip


def random_qp(kind: str, seed: int) -> Case:
    """The QP number `seed` of one of `KINDS` and its A x*."""
    return KINDS[kind](np.random.default_rng([seed, *kind.encode()]))


def contact_sequence(seed: int, length: int = 12) -> list[Case]:
    """QPs of successive steps: A and d drift, and twice rows are lost, gained and reordered.

    The solution of each is known.  The working set stays for most steps and changes in one row
    where it changes, as in the scenes.
    """
    rng = np.random.default_rng([seed, 77])
    base = tower_columns(3, True, rng)
    k = base.shape[1]
    tangent = (np.arange(k) % 3 == 1) & (np.arange(k) > 1)
    size, rows = 50.0, np.arange(k - 1)
    free = _choose(rng, k, 0.75)
    side = np.where(_choose(rng, k, 0.5), 1.0, -1.0)
    share = rng.uniform(0.2, 0.8, k)
    fall = rng.standard_normal(base.shape[:1])
    turned = np.ones(k)
    cases = []
    for step in range(length):
        if step % 4 == 3:
            i = int(rng.integers(k))
            free[i] = ~free[i]
        if step == length // 3:
            rows = np.delete(np.arange(k), 1)
        if step == 2 * length // 3:
            rows = np.arange(k)[::-1]
        A = (base + 1e-3 * step * rng.standard_normal(base.shape)) * turned
        bound = size * (0.5 + 0.01 * step)
        lower = np.where(tangent, -bound, 0.0)
        upper = np.where(tangent, bound, INF)
        inner = np.where(tangent, side * share * bound, 2 * share * size) * (1 + 0.01 * step)
        x = np.where(free, inner, np.where(tangent, side * bound, 0.0))
        A, x, lower, upper = A[:, rows], x[rows], lower[rows], upper[rows]
        flat = (x > lower) & (x < upper)
        r = size * _project_out(A[:, flat], fall + 0.01 * rng.standard_normal(fall.shape))
        slope = A.T @ r
        slope[flat] = 0.0
        wrong = ((x <= lower) & (slope < 0)) | ((x >= upper) & (slope > 0))
        # a turned column stays turned, so that the next A is close to this one
        turned[rows[wrong]] *= -1.0
        A[:, wrong] *= -1.0
        qp = ContactQP(A, r - A @ x, lower, upper, row_id=rows + 100, t=0.01 * step, h=0.01)
        cases.append((qp, A @ x))
    return cases
