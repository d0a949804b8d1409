"""Packages that take Coulomb's discs as they are: a QP with discs (6.1) as a program with cones.

    min ½‖y‖²,   A x − y = −d,   lower ≤ x ≤ upper,   (a, x_i, x_j) in the second-order cone

in y and x, so that A is not squared.  Columns of A are scaled to length 1, those of a disc alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.qp import Vector
from problems.space.discs import DiscQP

MANY = 200_000
"""Iterations of SCS."""


class NoAnswer(RuntimeError):
    """A package that gave none, with what it says."""


class Cones(NamedTuple):
    """min ½ zᵀP z with G z + s = h: s = 0 in `equal` rows, s ≥ 0 in `bounds` rows, then discs.

    z = (y, lengths x)/size, so that columns of A and d are of length 1
    """

    P: sp.csc_array
    G: sp.csc_array
    h: Vector
    equal: int
    bounds: int
    discs: int
    lengths: Vector
    size: float

    def x_of(self, z: Any) -> Vector:
        """x (k,) of the unknowns."""
        return self.size * np.asarray(z)[self.equal :] / self.lengths


def cones(qp: DiscQP) -> Cones:
    """The program of a QP with discs."""
    A = sp.csc_array(qp.A)
    m, k = A.shape
    lengths = np.sqrt(np.asarray(A.multiply(A).sum(axis=0)).ravel())
    lengths[qp.discs] = lengths[qp.discs].max(axis=1, keepdims=True)
    lengths[lengths == 0] = 1.0
    unit = sp.eye_array(k, format="csr")
    low, high = np.isfinite(qp.lower), np.isfinite(qp.upper)
    pairs = np.arange(3 * len(qp.radius)).reshape(-1, 3)
    where = pairs[:, 1:].ravel(), qp.discs.ravel()
    sides = sp.csr_array((-np.ones(qp.discs.size), where), shape=(pairs.size, k))
    top = np.zeros(pairs.size)
    top[pairs[:, 0]] = qp.radius * lengths[qp.discs[:, 0]]
    on_x = sp.vstack([-unit[low], unit[high], sides])
    scaled = A @ sp.diags_array(1 / lengths)
    G = sp.block_array([[-sp.eye_array(m), scaled], [None, on_x]], format="csc")
    bounds = np.concatenate([-(qp.lower * lengths)[low], (qp.upper * lengths)[high]])
    P = sp.block_diag([sp.eye_array(m), sp.csc_array((k, k))], format="csc")
    h = np.concatenate([-qp.d, bounds, top])
    size = max(float(np.linalg.norm(qp.d)), 1e-300)
    return Cones(P, G, h / size, m, len(bounds), len(qp.radius), lengths, size)


def by_clarabel(qp: DiscQP, accuracy: float) -> Vector:
    """x (k,) by interior points; accuracy : of residuals and gap, relative to ‖d‖."""
    import clarabel

    program = cones(qp)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_feas = settings.tol_gap_rel = settings.tol_gap_abs = accuracy
    kinds = [clarabel.ZeroConeT(program.equal), clarabel.NonnegativeConeT(program.bounds)]
    kinds += [clarabel.SecondOrderConeT(3)] * program.discs
    solver = clarabel.DefaultSolver(
        program.P, np.zeros(program.G.shape[1]), program.G, program.h, kinds, settings
    )
    found = solver.solve()
    if str(found.status) not in ("Solved", "AlmostSolved", "InsufficientProgress"):
        raise NoAnswer(f"clarabel: {found.status}")
    return program.x_of(found.x)


def by_scs(qp: DiscQP, accuracy: float) -> Vector:
    """x (k,) by operator splitting; accuracy : of residuals and gap, relative to ‖d‖."""
    import scs

    program = cones(qp)
    data = {
        "P": sp.csc_matrix(sp.triu(program.P)),
        "A": sp.csc_matrix(program.G),
        "b": program.h,
        "c": np.zeros(program.G.shape[1]),
    }
    cone = {"z": program.equal, "l": program.bounds, "q": [3] * program.discs}
    settings: dict[str, Any] = {"verbose": False, "max_iters": MANY, "linear_solver": "qdldl"}
    found = scs.SCS(data, cone, eps_abs=accuracy, eps_rel=0.0, **settings).solve()
    if "solved" not in found["info"]["status"]:
        raise NoAnswer(f"scs: {found['info']['status']}")
    return program.x_of(found["x"])


def by_cvxpy(qp: DiscQP, accuracy: float) -> Vector:
    """x (k,) as one writes it in CVXPY, handed on to Clarabel; accuracy : of residuals and gap."""
    import cvxpy as cp

    x = cp.Variable(qp.k)
    low, high = np.isfinite(qp.lower), np.isfinite(qp.upper)
    rules = [x[low] >= qp.lower[low], x[high] <= qp.upper[high]]
    rules += [cp.norm(x[pair]) <= a for pair, a in zip(qp.discs.tolist(), qp.radius, strict=True)]
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(qp.A @ x + qp.d)), rules)
    asked = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), accuracy)
    with warnings.catch_warnings():  # who asks judges by himself
        warnings.simplefilter("ignore", UserWarning)
        problem.solve(solver=cp.CLARABEL, **asked)
    if x.value is None:
        raise NoAnswer(f"cvxpy: {problem.status}")
    return np.asarray(x.value)


BY_DISCS: dict[str, Callable[[DiscQP, float], Vector]] = {
    "clarabel": by_clarabel,
    "cvxpy": by_cvxpy,
    "scs": by_scs,
}
"""Who takes discs as they are."""
