"""ProxQP, a proximal augmented Lagrangian method (proxsuite; Bambade et al. 2022).

The problem is posed in normal form with box constraints to the dense backend, or, where A is
sparse, with y = A x as rows to the sparse one with its Cholesky factors: left to itself that goes
over to an iterative method between 2,000 and 4,000 unknowns, which is a thousand times slower.  Any
other form of `programs` can be asked for.  P may be singular.

Accuracy: `eps_abs` is the residual and `eps_duality_gap_abs` the gap that `asked` allows, not below
1e-13 (two of the scenes' QPs never reach 1e-14); the relative ones are 0, but for the gap of large
QPs (`Posed.gap_share`).  Without the gap ProxQP may stop with a wrong complementarity (4e-6 off at
1e-9 asked).  No QP here is infeasible or unbounded, but towers of 500 boxes were called so; what
ProxQP takes for a proof of it is made very small.  In a sequence the workspace is updated in place
and goes on from what it ended with; a start that leads nowhere within `_PATIENCE` outer iterations
is given up for none.  A new workspace starts cold: `solve` refuses multipliers of a box.  Its last
bits depend on where its memory blocks lie: two solves of the same QP may differ by rounding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from proxsuite import proxqp

from problems.qp import Status, Vector
from solvers.adapters.inner_options import NEVER
from solvers.adapters.package import Built, Native, Outcome, change, same_kind
from solvers.adapters.posed import Posed
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_INFINITY = 1e20  # what proxsuite takes for an absent bound
_PATIENCE = 20  # outer iterations of a warm start: it needs two or three, or never ends
_EXHAUSTED = proxqp.QPSolverOutput.PROXQP_MAX_ITER_REACHED
_NOTHING_KNOWN = proxqp.InitialGuess.NO_INITIAL_GUESS
_LAST_RESULT = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
_NOTHING = (None,) * 5  # neither equations nor rows
_SETTINGS = {
    "eps_rel": 0.0,
    "eps_primal_inf": NEVER,
    "eps_dual_inf": NEVER,
    "check_duality_gap": True,
}


@dataclass(frozen=True)
class ProxQP(ProgramSolver):
    """ProxQP: proximal augmented Lagrangian, updated in place and warm-started."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "proxqp"
    package: ClassVar[str] = "proxsuite"
    warm_start: ClassVar[str] = "x and z"
    statuses: ClassVar[dict[Any, Status]] = {
        "PROXQP_SOLVED": Status.SOLVED,
        "PROXQP_MAX_ITER_REACHED": Status.ITERATION_LIMIT,
        "PROXQP_PRIMAL_INFEASIBLE": Status.INFEASIBLE,
        "PROXQP_DUAL_INFEASIBLE": Status.UNBOUNDED,
    }

    def best_form(self, posed: Posed) -> str:
        """With y = A x as rows where A is sparse."""
        return "residual" if posed.is_sparse else "normal"

    def starts_anew(self, posed: Posed) -> bool:
        """Not where bounds are a box: `solve` refuses multipliers of it."""
        return posed.is_sparse or self.program(posed).posed.form != "normal"

    def pack(self, program: Program) -> Any:
        """What `init` and `update` take: P, q, the equations, the other rows, the box.

        Bounds are a box in the dense backend, which the sparse one does not have.
        """
        sparse, lower, upper = program.posed.is_sparse, program.lower, program.upper
        if not sparse and program.posed.form == "normal":
            return program.P(sparse=False), program.q, *_NOTHING, *_ends(lower, upper)
        others = program.others
        A = program.rows(program.equations, sparse=sparse) if program.equal else None
        b = np.zeros(program.equal) if program.equal else None
        C = program.rows(others, sparse=sparse)
        return program.P(sparse=sparse), program.q, A, b, C, *_ends(lower[others], upper[others])

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Iterations and tolerances."""
        settings: dict[str, Any] = {"max_iter": self.max_iterations, "compute_timings": True}
        if asked is not None:
            settings["eps_abs"] = posed.residual_tolerance(asked, 1e-13)
            settings["eps_duality_gap_abs"] = posed.gap_tolerance(asked, 1e-13)
            settings["eps_duality_gap_rel"] = posed.gap_share
            settings |= _SETTINGS
        return settings

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the workspace of the previous solve, or make one, and put x, y and z there."""
        posed, arrays, options, carried, _, guess = problem
        box, before = _is_box(arrays), None if carried is None else carried.native
        if before is not None and not _alike(before, posed, arrays):
            before = None
        if before is not None:
            solver = before.object
            fill = solver.update
        else:
            solver = _solver(posed.is_sparse, arrays)
            fill = solver.init
        if box and before is None:  # `solve` refuses multipliers of it
            guess = None
        # `update` forgets what the last solve ended with, unless it is told so before
        options["initial_guess"] = _NOTHING_KNOWN if before is None else _LAST_RESULT
        if guess is not None or before is not None:
            options["max_iter"] = min(_PATIENCE, self.max_iterations)
        change(solver.settings, options, before)
        fill(*arrays)
        begin: Any = ()
        if guess is not None:
            program, (z, y) = self.program(posed), guess
            if box:
                solver.results.x, solver.results.z = z, y
            else:
                begin = z, y[program.equations] if program.equal else None, y[program.others]
                _set(solver, options, initial_guess=proxqp.InitialGuess.WARM_START)
        return Native(posed, solver, (arrays, begin), options)

    def run(self, native: Native) -> Any:
        """`QP.solve`, and once more from nothing where a start has led nowhere."""
        solver, (arrays, begin), options = native.object, native.arrays, native.options
        solver.solve(*begin)
        patient = options["max_iter"] == self.max_iterations
        if not patient and solver.results.info.status == _EXHAUSTED:
            _set(solver, options, max_iter=self.max_iterations, initial_guess=_NOTHING_KNOWN)
            solver.init(*arrays)  # `solve` alone keeps penalties of the run that failed
            solver.solve()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """ProxQP's status, iterations and time."""
        says = native.object.results
        info, z = says.info, np.array(says.z)
        y = z if native.posed.form == "normal" else self.program(native.posed).joined(says.y, z)
        return Outcome(np.array(says.x), info.status.name, info.iter, y, 1e-6 * info.run_time)


def _set(solver: Any, options: dict[str, Any], **more: Any) -> None:
    """Set some settings, and keep what they are."""
    for name, value in more.items():
        setattr(solver.settings, name, value)
    options |= more


def _alike(before: Native, posed: Posed, arrays: Any) -> bool:
    """Whether the object of the previous solve can be updated to these arrays, of the same form."""
    old = before.arrays[0]
    return posed.is_dense_like(before.posed) or (
        _is_box(old) == _is_box(arrays) and all(same_kind(old[i], arrays[i]) for i in (0, 2, 4))
    )


def _is_box(arrays: Any) -> bool:
    """Whether the bounds are a box and no rows."""
    return arrays[5] is None


def _ends(lower: Vector, upper: Vector) -> tuple[Vector, Vector]:
    """Bounds as proxsuite takes absent ones."""
    return np.maximum(lower, -_INFINITY), np.minimum(upper, _INFINITY)


def _solver(sparse: bool, arrays: Any) -> Any:
    """A workspace for a program of these sizes."""
    size, equal = arrays[1].size, 0 if arrays[3] is None else arrays[3].size
    if sparse:
        solver = proxqp.sparse.QP(size, equal, arrays[5].size)
        solver.settings.sparse_backend = proxqp.SparseBackend.SparseCholesky
        return solver
    if _is_box(arrays):
        return proxqp.dense.QP(size, 0, 0, True)
    return proxqp.dense.QP(size, equal, arrays[5].size)
