"""Hypothesis strategies of contact QPs that are hard on an active-set method.

A strategy draws the structure of a QP (sizes, rank, bounds, which rows are free, scales), so that a
failure shrinks to a small one, and a seed for the numbers in it.  The answer is chosen first, see
`random_qps.from_solution`, so that every QP comes with an x* of its own.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from numpy.typing import NDArray

from problems.qp import ContactQP, Vector
from tests.fakes.random_qps import INF, from_solution

Posed = tuple[ContactQP, Vector]
"""A QP and one of its answers, right to rounding."""

BOUNDS = ("one_sided", "two_sided", "upper_only", "unbounded", "fixed")
"""x ≥ l; l ≤ x ≤ u; x ≤ u with l = −inf; −inf … inf; l = u."""
PLACES = ("inside", "at_lower", "at_upper", "weak_lower", "weak_upper")
"""Where x* is; "weak" is at a bound with Δ = 0, a degenerate row."""
SMALLEST, LARGEST = -8, 8
"""Powers of ten of the scales of rows and columns."""


def placed(
    A: Vector, bounds: list[str], places: list[str], rng: np.random.Generator, **how: object
) -> Posed:
    """QP with these bounds whose x* is at these places; a place that a row lacks is "inside".

    A fixed row is where it has to be.  Column scales are of A only: ‖a‖ x is of size 1.
    """
    k = A.shape[1]
    norms = np.linalg.norm(A, axis=0)
    unit = np.where(norms > 0, norms, 1.0)
    kind, place = np.array(bounds, "U10"), np.array(places, "U10")
    low = np.where(np.isin(kind, ("one_sided", "two_sided", "fixed")), rng.integers(-1, 2, k), -INF)
    high = np.where(np.isin(kind, ("two_sided", "upper_only")), rng.integers(2, 4, k), INF)
    high = np.where(kind == "fixed", low, high)
    inner = np.clip(rng.uniform(-1.0, 1.0, k), low + 0.1, high - 0.1)
    inner = np.where(kind == "fixed", low, inner)
    at_low = np.isin(place, ("at_lower", "weak_lower")) & np.isfinite(low)
    at_high = np.isin(place, ("at_upper", "weak_upper")) & np.isfinite(high)
    z = np.where(at_low, low, np.where(at_high, high, inner))
    weak = np.char.startswith(place, "weak") & (at_low | at_high)
    # divided in the same way, so that a z at its bound gives an x at its bound
    x, lower, upper = z / unit, low / unit, high / unit
    return from_solution(A, x, lower, upper, rng, degenerate=weak, **how)[0], x  # type: ignore[arg-type]


@st.composite
def scales(draw: st.DrawFn, count: int) -> Vector:
    """`count` powers of ten, all 1 or anywhere from 1e-8 to 1e8."""
    if count == 0 or draw(st.booleans()):
        return np.ones(count)
    exponents = st.integers(SMALLEST, LARGEST)
    return 10.0 ** np.array(draw(st.lists(exponents, min_size=count, max_size=count)), float)


def rows_of(k: int, entries: tuple[str, ...]) -> st.SearchStrategy[list[str]]:
    return st.lists(st.sampled_from(entries), min_size=k, max_size=k)


@st.composite
def dense_qps(draw: st.DrawFn, most: int = 12, scaled_rows: bool = False) -> Posed:
    """k from 0 to `most` columns of any rank, m from 1 up; some columns equal, opposite or zero.

    scaled_rows : rows of A from 1e-8 to 1e8 in size, too, which makes columns dependent to rounding
    """
    m, k = draw(st.integers(1, most + 2)), draw(st.integers(0, most))
    rank = draw(st.integers(1, max(1, min(m, k))))
    bounds, places = draw(rows_of(k, BOUNDS)), draw(rows_of(k, PLACES))
    copies = draw(st.lists(st.tuples(st.integers(0, most), st.integers(0, most)), max_size=2))
    column_scale = draw(scales(k))
    row_scale = draw(scales(m)) if scaled_rows else np.ones(m)
    momentum = 10.0 ** draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = rng.standard_normal((m, rank)) @ rng.standard_normal((rank, k))
    if rank == min(m, k):
        A = rng.standard_normal((m, k))
    for here, there in copies:
        if here < k and there < k:
            A[:, here] = rng.integers(-1, 2) * A[:, there]
    A = row_scale[:, None] * A * column_scale
    return placed(A, bounds, places, rng, momentum=momentum)


@st.composite
def sparse_qps(draw: st.DrawFn, most_bodies: int = 40) -> Posed:
    """A in CSC as contacts make it: each column has 3 entries for one body or 6 for two.

    Contacts of a body with the ground (one block) and of neighbours in a random graph (two blocks);
    some columns are redundant; k is up to three times the bodies.
    """
    bodies = draw(st.one_of(st.integers(1, 4), st.integers(most_bodies // 2, most_bodies)))
    k = int(draw(st.sampled_from([0.5, 2.5, 3.0])) * bodies)
    bound_kinds = draw(st.sampled_from([BOUNDS[:1], BOUNDS[:2], BOUNDS]))
    place_kinds = draw(st.sampled_from([PLACES[:2], PLACES]))
    reach = draw(st.integers(1, 6))
    share_redundant = draw(st.sampled_from([0.0, 0.2]))
    scaled = draw(st.booleans())
    momentum = 10.0 ** draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = np.zeros((3 * bodies, k))
    for j in range(k):
        body = int(rng.integers(bodies))
        other = body + int(rng.integers(0, reach + 1))
        for touched in {body, other} if other < bodies else {body}:
            A[3 * touched : 3 * touched + 3, j] = rng.standard_normal(3)
        if j > 0 and rng.random() < share_redundant:
            A[:, j] = A[:, rng.integers(j)]
    if scaled:
        A *= 10.0 ** rng.integers(SMALLEST, LARGEST + 1, k)
    bounds = rng.choice(bound_kinds, k).tolist()
    places = rng.choice(place_kinds, k).tolist()
    return placed(A, bounds, places, rng, momentum=momentum, sparse=True)


def columns_of(qp: ContactQP, order: NDArray[np.int64]) -> ContactQP:
    """The QP of some of its columns, in this order; every row keeps its row_id."""
    A = qp.A[:, order] if sp.issparse(qp.A) else qp.dense_A[:, order]
    return ContactQP(A, qp.d, qp.lower[order], qp.upper[order], row_id=qp.row_id[order])


def yesterday(qp: ContactQP, seed: int, change: float) -> ContactQP:
    """An earlier QP of the same sequence: other numbers, rows in another order, gone and new.

    change : of A and d, relative; bounds are moved, opened and shut as well
    """
    rng = np.random.default_rng(seed)
    keep = rng.permutation(qp.k)[: rng.integers(0, qp.k + 1)]
    old = columns_of(qp, keep)
    new = int(rng.integers(0, 4))
    A = old.dense_A * (1 + change * rng.standard_normal((qp.m, keep.size)))
    A = np.hstack([A, rng.standard_normal((qp.m, new))])
    d = qp.d * (1 + change * rng.standard_normal(qp.m))
    span = np.where(old.upper - old.lower < INF, old.upper - old.lower, 0.0)
    lower = np.append(old.lower + span * rng.uniform(-0.5, 0.5, keep.size), np.zeros(new))
    upper = np.append(old.upper + span * rng.uniform(-0.5, 0.5, keep.size), np.full(new, INF))
    lower[rng.random(lower.size) < 0.1] = -INF
    upper = np.maximum(lower, upper)
    row_id = np.append(old.row_id, 10_000 + np.arange(new))
    order = rng.permutation(row_id.size)
    stored = A[:, order]
    return ContactQP(
        sp.csc_array(stored) if sp.issparse(qp.A) else stored,
        d, lower[order], upper[order], row_id=row_id[order],
    )  # fmt: skip
