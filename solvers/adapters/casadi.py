"""qpOASES and qrqp, the active-set methods that come with CasADi (Andersson et al. 2019).

qpOASES (Ferreau et al. 2014) is an online active-set method, qrqp a primal-dual one on a sparse QR
factorization.  Both are posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, dense, by
`casadi.conic`, whose function is called through its buffers: arrays are handed over as they are.

Accuracy: active-set methods are exact once they have the working set.  qrqp has a sparse QR without
pivoting: where P is singular, and now and then where it is not, it gives up or ends with a wrong
answer that it calls a success.  In a sequence the
function is kept while the rows are, and x and its multipliers start from the previous ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import casadi
import numpy as np

from problems.qp import Status, Vector
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.adapters.quietly import quietly
from solvers.base import Start

_OPTIONS: dict[str, dict[str, Any]] = {
    "qpoases": {"printLevel": "none", "error_on_fail": False, "enableRegularisation": False},
    "qrqp": {
        "print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False,
    },
}  # fmt: skip
_TAKES = ("h", "g", "lbx", "ubx", "x0", "lam_x0")


class _Function(NamedTuple):
    """A function of CasADi's with the arrays that it reads and writes."""

    function: Any
    buffer: Any
    call: Any
    x: Vector
    multipliers: Vector


def _function(plugin: str, n: int, limit: int) -> _Function:
    """A QP solver for n unknowns and no rows."""
    name = "nWSR" if plugin == "qpoases" else "max_iter"
    shapes = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity(0, n)}
    with quietly():  # qpOASES prints a banner
        made = casadi.conic(plugin, plugin, shapes, {**_OPTIONS[plugin], name: limit})
        buffer, call = made.buffer()
    x, multipliers = np.zeros(n), np.zeros(n)
    names = made.name_out()
    for name, array in (("x", x), ("lam_x", multipliers)):
        buffer.set_res(names.index(name), memoryview(array))  # type: ignore
    return _Function(made, buffer, call, x, multipliers)


@dataclass(frozen=True)
class QpOASES(PackageSolver):
    """qpOASES through CasADi: online active set, warm-started."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "qpoases"
    package: ClassVar[str] = "casadi"
    warm_start: ClassVar[str] = "x and multipliers"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "SOLVER_RET_SUCCESS": Status.SOLVED,
        "SOLVER_RET_LIMITED": Status.ITERATION_LIMIT,
        "SOLVER_RET_INFEASIBLE": Status.INFEASIBLE,
    }

    def arrays(self, posed: Posed) -> tuple[Vector, ...]:
        """P, q and the bounds."""
        return posed.P.ravel(), posed.q, posed.lower.copy(), posed.upper.copy()

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """The function of the previous solve, or a new one, pointed at today's arrays."""
        posed, arrays, _, carried, duals, _ = problem
        if carried is None:
            made = _function(self.name, posed.n, self.max_iterations)
        else:
            made = carried.native.object
        x, multipliers = made.x.copy(), made.multipliers.copy()
        if duals is not None:
            assert posed.start is not None
            x, multipliers = posed.start.copy(), duals.copy()
        elif posed.before is None:
            x[:] = multipliers[:] = 0.0
        names = made.function.name_in()
        handed = (*arrays, x, multipliers)
        for name, array in zip(_TAKES, handed, strict=True):
            made.buffer.set_arg(names.index(name), memoryview(array))
        return Native(posed, made, handed)

    def run(self, native: Native) -> Any:
        """The function's call."""
        native.object.call()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """CasADi's status, iterations and, of qpOASES, time."""
        made = native.object
        stats = made.buffer.stats()
        inside = stats.get("t_wall_solver", np.nan)
        status, iterations = stats["unified_return_status"], int(stats["iter_count"])
        x = made.x.copy() if stats["success"] else None
        return Outcome(x, status, max(iterations, 0), made.multipliers.copy(), inside)


@dataclass(frozen=True)
class Qrqp(QpOASES):
    """qrqp of CasADi: primal-dual active set on sparse QR, warm-started."""

    name: ClassVar[str] = "qrqp"
