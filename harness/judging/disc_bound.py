"""The bound that trusts nobody, where friction is bounded by discs: how far A x can be from A x*.

As for a QP with bounds: for x̄ within bounds and discs, r = A x̄ + d and any v such that
Δ = Aᵀ(r + v) has the signs that infinite bounds ask for,

    ‖A(x̄ − x*)‖ ≤ ½(‖v‖ + √(‖v‖² + 4g)),   g = max Δᵀ(x̄ − y) over all such y,

of which a disc has Δ_Dᵀ x̄_D + a|Δ_D|.  v is the least that makes Δ vanish along what is
free: entries between their bounds, pairs inside their disc, and of a pair on its edge the
tangent; or along some of that, since what is left of Δ on a disc counts in g alone.  What
misses a bound or an edge by little is tried there, by several littles; the least bound
found is kept.  Rounding is counted for r, and for what is left of Δ along what is free,
but not for Δ elsewhere.

There is no proof in exact arithmetic as there is for bounds (`harness.judging.proof`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.qp import Vector
from problems.space.discs import DiscQP

NEAR = (0.0, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4)
"""Parts of the largest force by which a force may miss its bound, or the edge of its disc, and be
tried there."""
KINDS = ("entries pairs tangents", "entries pairs", "entries tangents", "entries", "")
"""What Δ is made to vanish along, in turn."""
UNIT = 4 * float(np.finfo(float).eps)
"""Rounding in r, in units of ‖ |A||x| + |d| ‖."""
EDGE = 1e-13
"""Part of its radius by which a pair may miss the edge that it was moved to."""
DEPENDENT = 1e-12
"""Singular values below this part of the largest are none."""


def disc_error_bound(qp: DiscQP, x: Vector) -> float:
    """‖A(x − x*)‖ at most, from x alone."""
    A: Any = qp.A
    dense = A.toarray() if sp.issparse(A) else np.asarray(A)
    inside = qp.projected(x)
    size = float(np.abs(inside).max(initial=0.0))
    return min(
        _bound_at(qp, x, snapped, _free(qp, snapped, kinds), dense)
        for part in NEAR
        for snapped in (_snapped(qp, inside, part * size),)
        for kinds in KINDS
    )


def _snapped(qp: DiscQP, x: Vector, near: float) -> Vector:
    """x with entries moved to bounds, and pairs to edges, that are nearer than `near`."""
    moved = np.where(x <= qp.lower + near, qp.lower, x)
    moved = np.where(x >= qp.upper - near, qp.upper, moved)
    pairs = x[qp.discs]
    sizes = np.linalg.norm(pairs, axis=1)
    out = (sizes >= qp.radius - near) & (sizes > 0)
    scale = np.where(out, qp.radius / np.where(out, sizes, 1.0), 1.0)
    moved[qp.discs] = pairs * scale[:, None]
    return moved


def _bound_at(qp: DiscQP, x: Vector, inside: Vector, free: Vector, A: Vector) -> float:
    """The bound for x by the point `inside` bounds and discs, with Δ = 0 along `free`."""
    r = A @ inside + qp.d
    rounding = UNIT * float(np.linalg.norm(np.abs(A) @ np.abs(inside) + np.abs(qp.d)))
    wrong = np.zeros(qp.k, dtype=bool)
    best = float(np.linalg.norm(r))  # v = −r
    for _ in range(qp.k + 1):
        along = np.hstack([free, np.eye(qp.k)[:, wrong]])
        v, sigma = _undone(A @ along, r)
        delta = A.T @ (r + v)
        left = float(np.linalg.norm(along.T @ delta)) / sigma if sigma else 0.0
        delta = delta - along @ (along.T @ delta)  # which `left` undoes
        more = ((qp.upper == np.inf) & (delta < 0)) | ((qp.lower == -np.inf) & (delta > 0))
        more[qp.discs.ravel()] = False
        more &= ~wrong
        if not more.any():
            size = float(np.linalg.norm(v)) + left + rounding
            gain = max(_gain(qp, inside, delta), 0.0)
            best = min(best, 0.5 * (size + float(np.sqrt(size * size + 4 * gain))))
            break
        wrong |= more
    return best + float(np.linalg.norm(A @ (x - inside)))


def _free(qp: DiscQP, x: Vector, kinds: str) -> Vector:
    """Directions (k, s) of these kinds along which x may move both ways."""
    single = (x > qp.lower) & (x < qp.upper)
    single[qp.discs.ravel()] = False
    found = [np.eye(qp.k)[:, single if "entries" in kinds else []]]
    for (i, j), a in zip(qp.discs.tolist(), qp.radius.tolist(), strict=True):
        size = float(np.hypot(x[i], x[j]))
        if size < a * (1 - EDGE) and "pairs" in kinds:
            found.append(np.eye(qp.k)[:, [i, j]])
        elif size >= a * (1 - EDGE) > 0 and "tangents" in kinds:
            tangent = np.zeros((qp.k, 1))
            tangent[[i, j], 0] = -x[j] / size, x[i] / size
            found.append(tangent)
    return np.hstack(found)


def _gain(qp: DiscQP, x: Vector, delta: Vector) -> float:
    """max Δᵀ(x − y) over y within bounds and discs."""
    up, down = np.maximum(delta, 0.0), np.maximum(-delta, 0.0)
    held = qp.discs.ravel()
    up[held], down[held] = 0.0, 0.0
    with np.errstate(invalid="ignore"):
        below = np.where(up > 0, up * (x - qp.lower), 0.0)
        above = np.where(down > 0, down * (qp.upper - x), 0.0)
    pairs = delta[qp.discs]
    round_ = np.sum(pairs * x[qp.discs], axis=1) + qp.radius * np.linalg.norm(pairs, axis=1)
    return float(below.sum() + above.sum() + round_.sum())


def _undone(span: Vector, r: Vector) -> tuple[Vector, float]:
    """The least v with spanᵀ(r + v) = 0, and the least singular value that counts."""
    if span.shape[1] == 0:
        return np.zeros_like(r), 0.0
    U, sigma, _ = np.linalg.svd(span, full_matrices=False)
    kept = sigma > DEPENDENT * sigma.max(initial=0.0)
    U = U[:, kept]
    return -U @ (U.T @ r), float(sigma[kept].min()) if kept.any() else 0.0
