"""How far A moves in s steps, and what an R that is s steps old is worth as a preconditioner.

Conjugate gradients on min ‖A_F R_old⁻¹ y + r‖ with κ = cond(A_F R_old⁻¹) gain in each iteration at
least the factor

    ρ = (κ − 1)/(κ + 1),

so that an accuracy δ takes at most about ln(2/δ)/ln(1/ρ) iterations.  Whatever δ is, this bound
grows with s like 1/ln(1/ρ(s)).  Where A_F has moved little, κ − 1 is small and about proportional
to s, and

    d ln(bound)/d ln s ≈ 1/ln(2/(κ − 1)),

a small number: the exponent r = 1 of the paper's cost model asks for κ − 1 of the order of 1.

The bound does not know how many singular values are off.  If A_F − A_F,old = U Vᵀ has p columns in
U, then R_old⁻ᵀ A_Fᵀ A_F R_old⁻¹ is I but for rank 2p, and conjugate gradients end in at most 2p + 1
iterations (in exact arithmetic), however large κ is; never in more than f, the columns of A_F.
Where few contacts move relative to the others, iterations so stop growing.

1. Pairs of QPs n and n − s are sampled evenly, both after the same restart.
2. Their columns are matched by row_id and scaled to length 1, as algorithm 2 here does.
3. R_old is that of a fresh factorization of the columns in QP n − s that are free in QP n.  (A row
   that has come in between is left out: its column in R would be younger.)
4. On the sparse path A_F may hold dependent columns.  There R_oldᵀR_old = A_F,oldᵀA_F,old + shift
   stands for R_old, as there, and κ is that of the nonzero singular values: conjugate
   gradients do not see the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import ContactQP, Vector, positions_of
from solvers.active_set.tolerances import FIRST_SHIFT
from solvers.active_set.unit_costs import goes_sparse

AGES = (1, 2, 3, 5, 8, 12, 18, 25, 40, 60, 100)
SAMPLES = 24
"""Pairs sampled for each age."""
BUDGET = 1.5e11
"""Operations that the singular values may take; samples, then ages, are cut down to it."""
FEWEST = 4
"""Samples of an age below which nothing is said about it."""
FEWEST_AGES = 3
"""Ages below which nothing is said at all."""
SINGULAR = 1e-10
"""|r_jj|/max|r_ii| below which an old A_F tells nothing about today's."""
ZERO = 1e-11
"""Eigenvalue of A_Fᵀ A_F, in units of the largest, that is 0."""
CLOSEST = 1e-14
"""κ − 1 below this is rounding."""
OUTLYING = 0.1
"""A singular value of A_F R_old⁻¹ further than this from 1 is counted as off."""

COLUMNS = ("age", "samples", "moved", "condition", "condition_high", "outlying", "effort")


class Pair(NamedTuple):
    """Two QPs of one stretch.

    moved : ‖A_n − A_{n−s}‖_F/‖A_n‖_F over the rows that both have
    condition : κ of A_F R_old⁻¹;  outlying : how many of its singular values are not about 1
    """

    moved: float
    condition: float
    outlying: int


def drift(
    qps: Sequence[ContactQP], chains: Sequence[int], free: Sequence[NDArray[np.int64]]
) -> pd.DataFrame:
    """Sample how A and κ change with age; one row per age that has `FEWEST` pairs.

    qps : (n,) in order;  chains : (n,) number of the restart that each follows
    free : (n,) row_ids of the free columns of each

    Columns: age, samples, moved, condition and outlying (medians), condition_high (90th percentile)
    and effort, the mean of 1/ln(1/ρ).  Empty where A is too large for `BUDGET`.
    """
    chain = np.asarray(chains)
    size = max((qp.m * len(ids) ** 2 for qp, ids in zip(qps, free, strict=True)), default=0)
    pairs_in_all = int(BUDGET / (10 * size)) if size else SAMPLES * len(AGES)
    samples = min(SAMPLES, max(FEWEST, pairs_in_all // len(AGES)))
    ages = _spread(AGES, pairs_in_all // samples)
    rows = []
    for age in ages if len(ages) >= FEWEST_AGES else ():
        later = (
            np.flatnonzero(chain[age:] == chain[:-age]) + age if len(qps) > age else np.array([])
        )
        if later.size < FEWEST:
            continue
        chosen = later[np.unique(np.linspace(0, later.size - 1, samples).astype(int))]
        found = [compare(qps[n - age], qps[n], free[n]) for n in chosen]
        pairs = [pair for pair in found if pair is not None]
        if len(pairs) < FEWEST:
            continue
        conditions = np.array([pair.condition for pair in pairs])
        rows.append(
            {
                "age": age,
                "samples": len(pairs),
                "moved": float(np.median([pair.moved for pair in pairs])),
                "condition": float(np.median(conditions)),
                "condition_high": float(np.percentile(conditions, 90)),
                "outlying": float(np.median([pair.outlying for pair in pairs])),
                "effort": float(np.mean(effort(conditions))),
            }
        )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def compare(old: ContactQP, new: ContactQP, free: NDArray[np.int64]) -> Pair | None:
    """Compare two QPs; None without a common free column, or where the old ones are dependent."""
    common = new.row_id[positions_of(new.row_id, old.row_id) >= 0]
    kept = np.asarray(free)[positions_of(free, common) >= 0]
    if not kept.size:
        return None
    A_old, A_new = _columns(old, common), _columns(new, common)
    length = float(np.linalg.norm(A_new))
    moved = float(np.linalg.norm(A_new - A_old)) / length if length else 0.0
    values_of = _shifted_values if goes_sparse(new) else _values
    values = values_of(_unit(_columns(old, kept)), _unit(_columns(new, kept)))
    if values is None or values[-1] == 0.0:
        return None
    outlying = int(np.count_nonzero(np.abs(values - 1.0) > OUTLYING))
    return Pair(moved, float(values[0] / values[-1]), outlying)


def _values(B_old: Vector, B_new: Vector) -> Vector | None:
    """Singular values of B_new R_old⁻¹, falling; None where B_old has no R."""
    if B_old.shape[0] < B_old.shape[1]:
        return None
    R = np.linalg.qr(B_old, mode="r")
    diagonal = np.abs(np.diagonal(R))
    if diagonal.min() <= SINGULAR * diagonal.max():
        return None
    return scipy.linalg.svdvals(scipy.linalg.solve_triangular(R, B_new.T, trans="T").T)


def _shifted_values(B_old: Vector, B_new: Vector) -> Vector | None:
    """The nonzero ones of B_new R_old⁻¹, R_oldᵀ R_old = B_oldᵀ B_old + shift, falling (4.)."""
    old, new = B_old.T @ B_old, B_new.T @ B_new
    sizes = scipy.linalg.eigvalsh(new)
    rank = int((sizes > ZERO * sizes[-1]).sum())
    if rank < sizes.size:
        old[np.diag_indices_from(old)] += FIRST_SHIFT
    try:
        L = scipy.linalg.cholesky(old, lower=True)
    except np.linalg.LinAlgError:
        return None
    half = scipy.linalg.solve_triangular(L, new, lower=True)
    squares = scipy.linalg.eigvalsh(scipy.linalg.solve_triangular(L, half.T, lower=True))
    return np.sqrt(np.maximum(squares[::-1][:rank], 0.0))


def effort(condition: NDArray[np.float64]) -> NDArray[np.float64]:
    """1/ln(1/ρ), ρ = (κ − 1)/(κ + 1), to which the bound on the iterations is proportional."""
    beyond = np.maximum(np.asarray(condition) - 1.0, CLOSEST)
    return 1.0 / np.log1p(2.0 / beyond)


def predicted_exponent(table: pd.DataFrame) -> float:
    """r by the bound from κ: the slope of log(effort) over log(age); NaN for fewer than two."""
    if len(table) < 2:
        return float("nan")
    return float(np.polyfit(np.log(table["age"]), np.log(table["effort"]), 1)[0])


def _spread(ages: Sequence[int], most: int) -> list[int]:
    """At most so many of the ages, the first and the last among them."""
    if most < 2:
        return list(ages[:most])
    places = np.linspace(0, len(ages) - 1, min(most, len(ages))).round().astype(int)
    return [ages[place] for place in places]


def _columns(qp: ContactQP, ids: NDArray[np.int64]) -> Vector:
    """Dense columns of A for these row_ids (m, n)."""
    chosen: Any = qp.A[:, positions_of(ids, qp.row_id)]
    return np.asarray(chosen.toarray() if sp.issparse(chosen) else chosen)


def _unit(A: Vector) -> Vector:
    """Columns scaled to length 1; a zero column stays."""
    lengths = np.sqrt(np.einsum("ij,ij->j", A, A))
    lengths[lengths == 0.0] = 1.0
    return np.asarray(A / lengths)
