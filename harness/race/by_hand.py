"""The shortest call of each package that a careful user would write for a contact QP.

    min ½‖A x + d‖²,  lower ≤ x ≤ upper       as P = AᵀA, q = Aᵀd, or as the package wants it

Each is a class: made once for a set of rows, with what stays the same; `arrays` makes with NumPy
and SciPy what the package takes; `answer` sets up or updates, solves, and gives x.  Nothing is
shared with the adapters, and nothing is asked that a user who knows masses and forces would not:
the tolerance `tol` of x, and of the gap, `gap`, is handed over; `inside` is what the package's own
clock says of it, where it has one.

They are right for columns of length 1 or so, without fixed rows (`posed_for_hands`).  They are the
measure of adapters in `benchmarks/floors.py`, and of our methods in `harness.race.race`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from problems import ContactQP

INF = np.inf
CLOCK = time.perf_counter


class Hand:
    """A package called by hand, for QPs with the rows of `qp`."""

    most = 10**9
    """Columns beyond which it is not called: minutes."""
    one_sided = False
    """Whether x ≥ 0 is all that it takes."""

    def __init__(self, qp: ContactQP, tol: float, gap: float) -> None:
        self.m, self.k, self.tol, self.gap = qp.m, qp.k, tol, gap
        self.sparse = sp.issparse(qp.A)
        self.object: Any = None
        self.said: Any = None

    def arrays(self, qp: ContactQP) -> Any:
        """What the package takes."""
        raise NotImplementedError

    def answer(self, arrays: Any) -> Any:
        """x, once it is set up or updated, and solved; None where the package gives up."""
        raise NotImplementedError

    def after(self) -> None:
        """What belongs to no clock: the start of the next QP, where the package keeps none."""

    def inside(self) -> float:
        """[s] What the package's own clock says of the last set-up and solve; NaN without one."""
        return np.nan

    def P(self, qp: ContactQP) -> Any:
        """AᵀA as an array."""
        A: Any = qp.A
        return (A.T @ A).toarray() if self.sparse else A.T @ A

    def dense(self, qp: ContactQP) -> Any:
        """A as an array."""
        A: Any = qp.A
        return A.toarray() if self.sparse else A

    def upper_triangle(self, qp: ContactQP) -> sp.csc_matrix:
        """The upper triangle of AᵀA, CSC; of a dense one with its zeros."""
        if self.sparse:
            return sp.csc_matrix(sp.triu(qp.A.T @ qp.A))
        if not hasattr(self, "place"):
            column, row = np.tril_indices(self.k)
            pointers = np.r_[0, np.cumsum(np.arange(1, self.k + 1))]
            self.place, self.pattern = row * self.k + column, (row, pointers)
        data = (qp.A.T @ qp.A).ravel().take(self.place)
        return sp.csc_matrix((data, *self.pattern), shape=(self.k, self.k))


class Daqp(Hand):
    """One call, from the last working set."""

    most = 300

    def __init__(self, *made_for: Any) -> None:
        super().__init__(*made_for)
        self.rows, self.sense = np.zeros((0, self.k)), np.zeros(self.k, np.int32)

    def arrays(self, qp: ContactQP) -> Any:
        ends = qp.upper.copy(), qp.lower.copy()
        return self.P(qp), qp.A.T @ qp.d, self.rows, *ends, self.sense

    def answer(self, arrays: Any) -> Any:
        import daqp

        tol = self.tol
        found = daqp.solve(*arrays, primal_tol=tol, dual_tol=tol, eta_prox=1e-13 * self.k)
        self.said = found[3]
        return found[0]

    def after(self) -> None:
        """The working set, outside the clock as in the adapter."""
        lam = self.said["lam"]
        self.sense[:] = np.where(lam > 0, 1, np.where(lam < 0, 3, 0))

    def inside(self) -> float:
        return float(self.said["setup_time"] + self.said["solve_time"])


class Quadprog(Hand):
    """Rows of I; where P is singular and x ≥ 0, the velocity form, from the first such QP on."""

    most = 300
    velocity = False

    def __init__(self, qp: ContactQP, *rest: Any) -> None:
        super().__init__(qp, *rest)
        low, high = np.flatnonzero(qp.lower > -INF), np.flatnonzero(qp.upper < INF)
        self.low, self.high, one = low, high, np.eye(self.k)
        self.C = np.hstack([one[:, low], -one[:, high]]) if high.size else one
        self.simple = not high.size and not qp.lower.any()
        self.one = np.identity(self.m)

    def arrays(self, qp: ContactQP) -> Any:
        self.qp = qp
        if self.velocity:
            slack = np.full(self.k, -1e-14 * float(np.linalg.norm(qp.d)))
            return self.one, qp.d, np.array(self.dense(qp)), slack
        if self.high.size:
            b = np.concatenate([qp.lower[self.low], -qp.upper[self.high]])
        else:
            b = qp.lower.copy()
        return self.P(qp), -(qp.A.T @ qp.d), self.C, b

    def answer(self, arrays: Any) -> Any:
        import quadprog

        try:
            found = quadprog.solve_qp(*arrays)
        except ValueError:  # its only way to say that P is singular, or that it failed
            if self.velocity or not self.simple:
                return None
            self.velocity = True
            return self.answer(self.arrays(self.qp))
        return found[4] if self.velocity else found[0]


class Nnls(Hand):
    """A and −d."""

    most, one_sided = 300, True

    def arrays(self, qp: ContactQP) -> Any:
        return self.dense(qp), -qp.d

    def answer(self, arrays: Any) -> Any:
        from scipy.optimize import nnls

        return nnls(*arrays, maxiter=10 * self.k)[0]


class Osqp(Hand):
    """P and I, updated."""

    def arrays(self, qp: ContactQP) -> Any:
        return self.upper_triangle(qp), qp.A.T @ qp.d, qp.lower, qp.upper

    def answer(self, arrays: Any) -> Any:
        import osqp

        P, q, lower, upper = arrays
        if self.object is None:
            self.object = osqp.OSQP()
            self.object.setup(
                P, q, sp.identity(self.k, format="csc"), lower, upper, verbose=False,
                eps_abs=self.tol, eps_rel=0.0, max_iter=20_000, check_dualgap=False,
                eps_prim_inf=1e-14, eps_dual_inf=1e-14,
            )  # fmt: skip
        else:
            self.object.update_settings(eps_abs=self.tol)
            self.object.update(Px=P.data, q=q, l=lower, u=upper)
        self.said = self.object.solve(raise_error=False)
        return self.said.x

    def inside(self) -> float:
        return float(self.said.info.run_time)


class Piqp(Hand):
    """P and a box, updated; dense or sparse as A is."""

    def arrays(self, qp: ContactQP) -> Any:
        P = sp.csc_matrix(qp.A.T @ qp.A) if self.sparse else np.asfortranarray(self.P(qp))
        return {"P": P, "c": qp.A.T @ qp.d, "x_l": qp.lower, "x_u": qp.upper}

    def answer(self, arrays: Any) -> Any:
        import piqp

        fresh = self.object is None
        if fresh:
            self.object = piqp.SparseSolver() if self.sparse else piqp.DenseSolver()
            settings = self.object.settings
            settings.eps_rel, settings.eps_duality_gap_rel = 0.0, 1e-15 * self.k
            settings.eps_abs, settings.eps_duality_gap_abs = self.tol, self.gap
            settings.verbose, settings.compute_timings = False, True
            for name in ("eps_primal_inf", "eps_dual_inf"):
                if hasattr(settings, name):
                    setattr(settings, name, 1e-100)
        (self.object.setup if fresh else self.object.update)(**arrays)
        self.object.solve()
        return np.array(self.object.result.x)

    def inside(self) -> float:
        info = self.object.result.info
        return float((info.update_time or info.setup_time) + info.solve_time)


class Proxqp(Hand):
    """Dense: P and a box.  Sparse: y = A x as rows."""

    most = 300

    def arrays(self, qp: ContactQP) -> Any:
        q, ends = qp.A.T @ qp.d, (np.maximum(qp.lower, -1e20), np.minimum(qp.upper, 1e20))
        if not self.sparse:
            return self.P(qp), q, *(None,) * 5, *ends
        if self.object is None:
            n, m = self.k, self.m
            self.H = sp.csc_matrix(sp.diags_array(np.r_[np.zeros(n), np.ones(m)]))
            self.C = sp.csc_matrix(sp.identity(n + m, format="csr")[:n])
            self.minus, self.none = -sp.identity(m, format="csc"), np.zeros(m)
        A = sp.hstack([qp.A, self.minus], format="csc")
        return self.H, np.concatenate([q, self.none]), A, self.none, self.C, *ends

    def answer(self, arrays: Any) -> Any:
        from proxsuite import proxqp

        if self.object is None:
            if self.sparse:
                made = proxqp.sparse.QP(self.k + self.m, self.m, self.k)
                made.settings.sparse_backend = proxqp.SparseBackend.SparseCholesky
            else:
                made = proxqp.dense.QP(self.k, 0, 0, True)
            settings = made.settings
            settings.eps_abs, settings.eps_rel = self.tol, 0.0
            settings.check_duality_gap, settings.eps_duality_gap_rel = True, 1e-15 * self.k
            settings.eps_duality_gap_abs = self.gap
            settings.eps_primal_inf = settings.eps_dual_inf = 1e-14
            settings.compute_timings = True
            settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            made.init(*arrays)
            self.object = made
        else:
            self.object.update(*arrays)
        self.object.solve()
        return np.array(self.object.results.x[: self.k])

    def inside(self) -> float:
        return 1e-6 * float(self.object.results.info.run_time)


class Clarabel(Hand):
    """P and −I; where A is sparse and x ≥ 0, the velocity form."""

    def __init__(self, qp: ContactQP, *rest: Any) -> None:
        super().__init__(qp, *rest)
        self.dual = self.sparse and not qp.lower.any() and bool((qp.upper == INF).all())
        low, high = np.flatnonzero(qp.lower > -INF), np.flatnonzero(qp.upper < INF)
        one = sp.identity(self.k, format="csr")
        self.low, self.high = low, high
        self.G = sp.csc_matrix(sp.vstack([-one[low], one[high]]))
        self.one, self.none = sp.identity(self.m, format="csc"), np.zeros(self.k)

    def arrays(self, qp: ContactQP) -> Any:
        if self.dual:
            return self.one, -qp.d, sp.csc_matrix(-qp.A.T), self.none
        h = np.concatenate([-qp.lower[self.low], qp.upper[self.high]])
        return self.upper_triangle(qp), qp.A.T @ qp.d, self.G, h

    def answer(self, arrays: Any) -> Any:
        import clarabel

        P, q, G, h = arrays
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.presolve_enable, settings.max_threads = False, False, 1
        settings.static_regularization_constant = 1e-12
        settings.tol_gap_abs, settings.tol_gap_rel = self.gap, 1e-15 * self.k
        settings.tol_feas = self.tol
        if self.object is None:
            cone = [clarabel.NonnegativeConeT(h.size)]
            self.object = clarabel.DefaultSolver(P, q, G, h, cone, settings)
        else:
            self.object.update(P=P.data, q=q, A=G.data, b=h, settings=settings)
        self.said = self.object.solve()
        return np.array(self.said.z if self.dual else self.said.x)

    def inside(self) -> float:
        return float(self.said.solve_time)


class Scs(Hand):
    """P and −I, set up anew: it cannot update P."""

    most = 120

    def __init__(self, qp: ContactQP, *rest: Any) -> None:
        super().__init__(qp, *rest)
        self.low, self.high = np.flatnonzero(qp.lower > -INF), np.flatnonzero(qp.upper < INF)
        one = sp.identity(self.k, format="csr")
        self.G = sp.csc_matrix(sp.vstack([-one[self.low], one[self.high]]))

    def arrays(self, qp: ContactQP) -> Any:
        h = np.concatenate([-qp.lower[self.low], qp.upper[self.high]])
        return {"P": self.upper_triangle(qp), "A": self.G, "b": h, "c": qp.A.T @ qp.d}

    def answer(self, arrays: Any) -> Any:
        import scs

        size = arrays["b"].size
        made = scs.SCS(arrays, {"l": size}, verbose=False, eps_abs=self.tol, eps_rel=0.0,
                       max_iters=20_000, linear_solver="qdldl")  # fmt: skip
        last = self.object
        again = (False,) if last is None else (True, last["x"], last["y"], last["s"])
        self.object = made.solve(*again)
        return self.object["x"]

    def inside(self) -> float:
        info = self.object["info"]
        return 1e-3 * float(info["setup_time"] + info["solve_time"])


class Highs(Hand):
    """The lower triangle of P and an empty row; where A is sparse and tall, the velocity form."""

    most = 300

    def __init__(self, qp: ContactQP, *rest: Any) -> None:
        super().__init__(qp, *rest)
        tall = self.sparse and self.k <= self.m
        self.dual = tall and not qp.lower.any() and bool((qp.upper == INF).all())
        size = self.m if self.dual else self.k
        self.kind, self.free = np.zeros(size, np.int32), np.full(size, INF)
        self.row, self.zero = sp.csc_matrix((1, size)), np.zeros(1)
        self.one = sp.identity(size, format="csc")
        column, row = np.triu_indices(self.k)
        self.lower = row * self.k + column, row, np.r_[0, np.cumsum(np.arange(self.k, 0, -1))]
        self.ends = np.zeros(self.k), np.full(self.k, INF)

    def arrays(self, qp: ContactQP) -> Any:
        if self.dual:
            A = sp.csc_matrix(qp.A.T)
            P = self.one.indptr, self.one.indices, self.one.data
            return self._packed(-qp.d, (-self.free, self.free), A, self.ends, P)
        q = qp.A.T @ qp.d
        if self.sparse:
            L = sp.csc_matrix(sp.tril(qp.A.T @ qp.A))
            P = L.indptr, L.indices, L.data
        else:
            place, row, pointers = self.lower
            P = pointers, row, (qp.A.T @ qp.A).ravel().take(place)
        return self._packed(q, (qp.lower, qp.upper), self.row, (self.zero, self.zero), P)

    def _packed(self, q: Any, box: Any, A: Any, ends: Any, P: Any) -> Any:
        sizes = q.size, ends[0].size, A.nnz, P[2].size
        return (*sizes, 1, 1, 1, 0.0, q, *box, *ends, A.indptr, A.indices, A.data, *P, self.kind)

    def answer(self, arrays: Any) -> Any:
        import highspy

        if self.object is None:
            self.object = highspy.Highs()
            for name, value in (
                ("output_flag", False), ("threads", 1), ("qp_regularization_value", 0.0),
                ("primal_feasibility_tolerance", 1e-10), ("dual_feasibility_tolerance", 1e-10),
            ):  # fmt: skip
                self.object.setOptionValue(name, value)
        self.object.passModel(*arrays)
        self.object.run()
        found = self.object.getSolution()
        return np.array(found.row_dual if self.dual else found.col_value)


class _Casadi(Hand):
    most = 120
    plugin = ""
    options: dict[str, Any] = {}  # noqa: RUF012

    def arrays(self, qp: ContactQP) -> Any:
        return self.P(qp).ravel(), qp.A.T @ qp.d, qp.lower.copy(), qp.upper.copy()

    def answer(self, arrays: Any) -> Any:
        import casadi

        n = self.k
        if self.object is None:
            shapes = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity(0, n)}
            made = casadi.conic("hand", self.plugin, shapes, self.options)
            buffer, call = made.buffer()
            self.x, self.lam = np.zeros(n), np.zeros(n)
            for result, array in (("x", self.x), ("lam_x", self.lam)):
                written: Any = array
                buffer.set_res(made.name_out().index(result), memoryview(written))
            names = made.name_in()
            self.places = [names.index(name) for name in ("h", "g", "lbx", "ubx", "x0", "lam_x0")]
            self.object = made, buffer, call
        _, buffer, call = self.object
        self.handed = *arrays, self.x.copy(), self.lam.copy()
        for place, array in zip(self.places, self.handed, strict=True):
            buffer.set_arg(place, memoryview(array))
        call()
        return self.x.copy()


class QpOases(_Casadi):
    """Online active set, through buffers."""

    plugin = "qpoases"
    options = {"printLevel": "none", "error_on_fail": False, "enableRegularisation": False}  # noqa: RUF012


class Qrqp(_Casadi):
    """Primal-dual active set, through buffers."""

    plugin = "qrqp"
    options = {  # noqa: RUF012
        "print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False,
    }  # fmt: skip


def posed_for_hands(qp: ContactQP) -> bool:
    """Whether a QP has columns, and no fixed ones."""
    return qp.k > 0 and bool((qp.lower < qp.upper).all())


def takes(kind: type[Hand], qps: Sequence[ContactQP]) -> bool:
    """Whether a package is called with these QPs."""
    one_sided = all(not qp.lower.any() and bool((qp.upper == INF).all()) for qp in qps)
    return max(qp.k for qp in qps) <= kind.most and (one_sided or not kind.one_sided)


def timed(hand: Hand, qp: ContactQP) -> tuple[float, float, Any]:
    """Seconds of making the arrays and of the answer, and x."""
    t0 = CLOCK()
    arrays = hand.arrays(qp)
    t1 = CLOCK()
    x = hand.answer(arrays)
    t2 = CLOCK()
    hand.after()
    return t1 - t0, t2 - t1, x


class Called:
    """A package called by hand along a sequence, made anew where rows or pattern are others."""

    def __init__(self, kind: type[Hand], warm: bool = True) -> None:
        self._kind, self._warm = kind, warm
        self._made_for: tuple[bytes, ...] = ()
        self.hand: Hand

    def ready_for(self, qp: ContactQP) -> Hand:
        """The package for this QP, whose accuracy is `eps0`; anew at every QP if not `warm`."""
        rows: tuple[bytes, ...] = qp.row_id.tobytes(), (qp.upper < INF).tobytes()
        A: Any = qp.A
        if sp.issparse(A):
            rows = *rows, A.indptr.tobytes(), A.indices.tobytes()
        if rows != self._made_for or not self._warm:
            self._made_for = rows
            self.hand = self._kind(qp, 0.1 * qp.eps0 / qp.k**0.5, max(0.5 * qp.eps0**2, 1e-13))
        return self.hand

    def forget(self) -> None:
        """The package is made anew for the next QP: it has raised at this one."""
        self._made_for = ()


HANDS: dict[str, type[Hand]] = {
    "daqp": Daqp,
    "quadprog": Quadprog,
    "scipy_nnls": Nnls,
    "proxqp": Proxqp,
    "piqp": Piqp,
    "osqp": Osqp,
    "clarabel": Clarabel,
    "highs": Highs,
    "scs": Scs,
    "qpoases": QpOases,
    "qrqp": Qrqp,
}
"""By the name of the adapter."""
