"""The QP of a step as the paper poses it in space, with Coulomb's discs (6.1).

    min ½‖A x + d‖²,   lower ≤ x ≤ upper,   |(x_i, x_j)| ≤ a for each disc (i, j, a),   a = μ λ_*

`problems.space.passes` solves it by bounds alone.  Here it is posed as it is: for packages that
take cones, for the bound on the error of any answer, and to show what a polygon makes of a disc.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.qp import ContactQP, Indices, Matrix, Vector

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


@dataclass(frozen=True, eq=False)
class DiscQP:
    """A QP with bounds and discs.

    A : (m, k), dense or CSC;  d : (m,);  lower, upper : (k,)
    discs : (n, 2) columns, which no bounds hold otherwise;  radius : (n,), at least 0

    Raises ValueError for wrong shapes, and for columns that are bounded twice.
    """

    A: Matrix
    d: Vector
    lower: Vector
    upper: Vector
    discs: Indices
    radius: Vector

    def __post_init__(self) -> None:
        m, k = self.A.shape
        shapes = (self.d, (m,)), (self.lower, (k,)), (self.upper, (k,))
        for array, shape in (*shapes, (self.discs, (len(self.radius), 2))):
            if array.shape != shape:
                raise ValueError(f"DiscQP: an array has shape {array.shape}; A asks for {shape}")
        if not (self.radius >= 0).all() or not (self.lower <= self.upper).all():
            raise ValueError("DiscQP: radii must be at least 0, and lower bounds below upper ones")
        held = self.discs.ravel()
        if (
            len(set(held.tolist())) < held.size
            or np.isfinite([self.lower, self.upper])[:, held].any()
        ):
            raise ValueError("DiscQP: a column of a disc has a bound, or another disc")

    @property
    def k(self) -> int:
        return self.A.shape[1]

    def residual(self, x: Vector) -> Vector:
        """A x + d (m,)."""
        return np.asarray(self.A @ x + self.d)

    def projected(self, x: Vector) -> Vector:
        """The point nearest to x that is within bounds and discs (k,)."""
        inside = np.clip(x, self.lower, self.upper)
        pairs = inside[self.discs]
        sizes = np.linalg.norm(pairs, axis=1)
        beyond = sizes > self.radius
        scale = np.where(beyond, self.radius / np.where(beyond, sizes, 1.0), 1.0)
        inside[self.discs] = pairs * scale[:, None]
        return inside

    def faceted(self, faces: int) -> tuple[ContactQP, Matrix]:
        """The same with regular polygons in place of the discs, their corners on them; and T (k, l)
        with x = T c of its unknowns c.

        λ_F = Σ c_j t_j, |c_j| ≤ a sin(π/faces), directions t_j at 2π/faces from each other.
        """
        angles = 2 * np.pi / faces * np.arange(faces // 2)
        n, each = len(self.radius), faces // 2
        others = np.setdiff1d(np.arange(self.k), self.discs)
        rows = [others, np.repeat(self.discs[:, 0], each), np.repeat(self.discs[:, 1], each)]
        fan = others.size + np.arange(n * each)
        columns = [np.arange(others.size), fan, fan]
        values = [np.ones(others.size), np.tile(np.cos(angles), n), np.tile(np.sin(angles), n)]
        shape = (self.k, others.size + n * each)
        places = np.concatenate(rows), np.concatenate(columns)
        T = sp.csc_array((np.concatenate(values), places), shape=shape)
        most = np.repeat(self.radius * np.sin(np.pi / faces), each)
        A: Any = self.A @ T if sp.issparse(self.A) else np.ascontiguousarray(self.A @ T.toarray())
        lower, upper = (
            np.append(b[others], s * most) for b, s in ((self.lower, -1), (self.upper, 1))
        )
        return ContactQP(A, self.d, lower, upper), T

    def error_bound(self, x: Vector) -> float:
        """‖A(x − x*)‖ at most, from x alone.

        As for a QP with bounds: for x̄ within bounds and discs, r = A x̄ + d and any v such that
        Δ = Aᵀ(r + v) has the signs that infinite bounds ask for,

            ‖A(x̄ − x*)‖ ≤ ½(‖v‖ + √(‖v‖² + 4g)),   g = max Δᵀ(x̄ − y) over all such y,

        of which a disc has Δ_Dᵀ x̄_D + a|Δ_D|.  v is the least that makes Δ vanish along what is
        free: entries between their bounds, pairs inside their disc, and of a pair on its edge the
        tangent; or along some of that, since what is left of Δ on a disc counts in g alone.  What
        misses a bound or an edge by little is tried there, by several littles; the least bound
        found is kept.  Rounding is counted for r, and for what is left of Δ along what is free,
        but not for Δ elsewhere.
        """
        A: Any = self.A
        dense = A.toarray() if sp.issparse(A) else np.asarray(A)
        inside = self.projected(x)
        size = float(np.abs(inside).max(initial=0.0))
        return min(
            self._bound_at(x, snapped, self._free(snapped, kinds), dense)
            for part in NEAR
            for snapped in (self._snapped(inside, part * size),)
            for kinds in KINDS
        )

    def _snapped(self, x: Vector, near: float) -> Vector:
        """x with entries moved to bounds, and pairs to edges, that are nearer than `near`."""
        moved = np.where(x <= self.lower + near, self.lower, x)
        moved = np.where(x >= self.upper - near, self.upper, moved)
        pairs = x[self.discs]
        sizes = np.linalg.norm(pairs, axis=1)
        out = (sizes >= self.radius - near) & (sizes > 0)
        scale = np.where(out, self.radius / np.where(out, sizes, 1.0), 1.0)
        moved[self.discs] = pairs * scale[:, None]
        return moved

    def _bound_at(self, x: Vector, inside: Vector, free: Vector, A: Vector) -> float:
        """The bound for x by the point `inside` bounds and discs, with Δ = 0 along `free`."""
        r = A @ inside + self.d
        rounding = UNIT * float(np.linalg.norm(np.abs(A) @ np.abs(inside) + np.abs(self.d)))
        wrong = np.zeros(self.k, dtype=bool)
        best = float(np.linalg.norm(r))  # v = −r
        for _ in range(self.k + 1):
            along = np.hstack([free, np.eye(self.k)[:, wrong]])
            v, sigma = _undone(A @ along, r)
            delta = A.T @ (r + v)
            left = float(np.linalg.norm(along.T @ delta)) / sigma if sigma else 0.0
            delta = delta - along @ (along.T @ delta)  # which `left` undoes
            more = ((self.upper == np.inf) & (delta < 0)) | ((self.lower == -np.inf) & (delta > 0))
            more[self.discs.ravel()] = False
            more &= ~wrong
            if not more.any():
                size = float(np.linalg.norm(v)) + left + rounding
                gain = max(self._gain(inside, delta), 0.0)
                best = min(best, 0.5 * (size + float(np.sqrt(size * size + 4 * gain))))
                break
            wrong |= more
        return best + float(np.linalg.norm(A @ (x - inside)))

    def _free(self, x: Vector, kinds: str) -> Vector:
        """Directions (k, s) of these kinds along which x may move both ways."""
        single = (x > self.lower) & (x < self.upper)
        single[self.discs.ravel()] = False
        found = [np.eye(self.k)[:, single if "entries" in kinds else []]]
        for (i, j), a in zip(self.discs.tolist(), self.radius.tolist(), strict=True):
            size = float(np.hypot(x[i], x[j]))
            if size < a * (1 - EDGE) and "pairs" in kinds:
                found.append(np.eye(self.k)[:, [i, j]])
            elif size >= a * (1 - EDGE) > 0 and "tangents" in kinds:
                tangent = np.zeros((self.k, 1))
                tangent[[i, j], 0] = -x[j] / size, x[i] / size
                found.append(tangent)
        return np.hstack(found)

    def _gain(self, x: Vector, delta: Vector) -> float:
        """max Δᵀ(x − y) over y within bounds and discs."""
        up, down = np.maximum(delta, 0.0), np.maximum(-delta, 0.0)
        held = self.discs.ravel()
        up[held], down[held] = 0.0, 0.0
        with np.errstate(invalid="ignore"):
            below = np.where(up > 0, up * (x - self.lower), 0.0)
            above = np.where(down > 0, down * (self.upper - x), 0.0)
        pairs = delta[self.discs]
        round_ = np.sum(pairs * x[self.discs], axis=1) + self.radius * np.linalg.norm(pairs, axis=1)
        return float(below.sum() + above.sum() + round_.sum())


def _undone(span: Vector, r: Vector) -> tuple[Vector, float]:
    """The least v with spanᵀ(r + v) = 0, and the least singular value that counts."""
    if span.shape[1] == 0:
        return np.zeros_like(r), 0.0
    U, sigma, _ = np.linalg.svd(span, full_matrices=False)
    kept = sigma > DEPENDENT * sigma.max(initial=0.0)
    U = U[:, kept]
    return -U @ (U.T @ r), float(sigma[kept].min()) if kept.any() else 0.0
