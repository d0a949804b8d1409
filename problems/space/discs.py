"""The QP of a step as the paper poses it in space, with Coulomb's discs (6.1).

    min ½‖A x + d‖²,   lower ≤ x ≤ upper,   |(x_i, x_j)| ≤ a for each disc (i, j, a),   a = μ λ_*

`problems.space.passes` solves it by bounds alone.  Here it is posed as it is: for packages that
take cones, for the bound on the error of any answer (`harness.judging.disc_bound`), and to show
what a polygon makes of a disc.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.qp import ContactQP, Indices, Matrix, Vector
from problems.space.friction import fan, share_of


@dataclass(frozen=True, eq=False)
class DiscQP:
    """A QP with bounds and discs.

    A : (m, k), dense or CSC;  d : (m,);  lower, upper : (k,)
    discs : (n, 2) columns, which no bounds hold otherwise;  radius : (n,), at least 0
    t : end of the step [s]

    Raises ValueError for wrong shapes, for columns that there are not, and for those that are
    bounded twice.
    """

    A: Matrix
    d: Vector
    lower: Vector
    upper: Vector
    discs: Indices
    radius: Vector
    t: float = 0.0

    def __post_init__(self) -> None:
        m, k = self.A.shape
        shapes = (self.d, (m,)), (self.lower, (k,)), (self.upper, (k,))
        for array, shape in (*shapes, (self.discs, (len(self.radius), 2))):
            if array.shape != shape:
                raise ValueError(f"DiscQP: an array has shape {array.shape}; A asks for {shape}")
        if not (self.radius >= 0).all() or not (self.lower <= self.upper).all():
            raise ValueError("DiscQP: radii must be at least 0, and lower bounds below upper ones")
        held = self.discs.ravel()
        if ((held < 0) | (held >= k)).any():
            raise ValueError(f"DiscQP: a disc is of a column that there is not; A has {k}")
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

        λ_F = Σ c_j t_j with the directions and the bounds of `problems.space.friction`.
        """
        ways = fan(faces)
        n, each = len(self.radius), len(ways)
        others = np.setdiff1d(np.arange(self.k), self.discs)
        rows = [others, np.repeat(self.discs[:, 0], each), np.repeat(self.discs[:, 1], each)]
        fans = others.size + np.arange(n * each)
        columns = [np.arange(others.size), fans, fans]
        values = [np.ones(others.size), *np.tile(ways, (n, 1)).T]
        shape = (self.k, others.size + n * each)
        places = np.concatenate(rows), np.concatenate(columns)
        T = sp.csc_array((np.concatenate(values), places), shape=shape)
        most = np.repeat(self.radius * share_of(faces), each)
        A: Any = self.A @ T if sp.issparse(self.A) else np.ascontiguousarray(self.A @ T.toarray())
        lower, upper = (
            np.append(b[others], s * most) for b, s in ((self.lower, -1), (self.upper, 1))
        )
        return ContactQP(A, self.d, lower, upper), T
