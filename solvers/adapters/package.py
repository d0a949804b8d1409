"""What adapters of packages share: native objects kept and updated, answers read."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.qp import (
    AT_LOWER,
    AT_UPPER,
    ContactQP,
    Solution,
    Status,
    Vector,
    positions_of,
    working_set_of,
)
from solvers.adapters.posed import Posed, pose
from solvers.base import Answer, Solver, Start


class Native(NamedTuple):
    """A package's object, ready to run, with the problem that it holds."""

    posed: Posed
    object: Any
    arrays: Any = None


class Carried(NamedTuple):
    """`Solution.memory` of a package: its object and duals, for the next solve.

    Without duals they are those of the x that is started from.
    """

    native: Native
    duals: Vector | None = None


class Built(NamedTuple):
    """What `build` hands to `setup`: nothing is left to do there but to call the package.

    posed : the scaled problem
    arrays : the package's form of it, see `PackageSolver.arrays`
    carried : what the previous solve left, if it had the same unknowns in the same order
    guess : z and y that belong to the start in the form of a `programs.ProgramSolver`
    duals : (n,) its multipliers of the bounds in today's scale, 0 for new rows, or those that
        belong to a start that comes without memory; None when cold
    """

    posed: Posed
    arrays: Any
    carried: Carried | None
    duals: Vector | None
    guess: tuple[Vector, Vector] | None = None


class Outcome(NamedTuple):
    """What a package says.

    x : scaled unknowns, at least n of them, or None;  status : the package's own
    duals : (n,) multipliers of the bounds, scaled, in the package's sign
    """

    x: Vector | None
    status: Any
    iterations: int = 0
    duals: Vector | None = None


@dataclass(frozen=True)
class PackageSolver(Solver, abc.ABC):
    """A solver that is posed scaled problems without fixed rows, see `Posed`.

    Derived classes write `arrays`, `setup`, `run` and `outcome`, and the table `statuses`.
    """

    dense: ClassVar[bool] = False
    """Whether the package takes dense matrices only."""
    statuses: ClassVar[dict[Any, Status]] = {}
    """The package's statuses; one that is not here is FAILED, with its text kept."""

    @abc.abstractmethod
    def arrays(self, posed: Posed) -> Any:
        """The scaled problem in the package's own form."""

    @abc.abstractmethod
    def outcome(self, native: Native, result: Any) -> Outcome:
        """What the package says."""

    def in_x(self, native: Native, says: Outcome) -> Outcome:
        """What the package says, of the scaled unknowns of `Posed`, where it was posed others."""
        return says

    def build(self, qp: ContactQP, start: Start | None) -> Built:
        """Scale the QP, leave the fixed rows out and bring it into the package's form."""
        posed = pose(qp, start, dense=self.dense)
        carried = duals = None
        if start is not None and isinstance(start.memory, Carried):
            old = start.memory.native.posed
            if old.m == posed.m and np.array_equal(old.rows, posed.rows):
                carried = start.memory
            if start.memory.duals is not None:
                duals = _carried_duals(start.memory, posed)
        if start is not None and duals is None and (start.previous >= 0).any():
            duals = _bound_multipliers(posed)
        return Built(posed, self.arrays(posed), carried, duals)

    def adopt(self, memory: Any, start: Solution) -> Any:
        """The package's object; the multipliers will be those of `start`."""
        return Carried(memory.native) if isinstance(memory, Carried) else None

    def read(self, qp: ContactQP, native: Native, result: Any) -> Answer:
        """Map the package's result by the table of statuses."""
        says = self.in_x(native, self.outcome(native, result))
        status = self.statuses.get(says.status, Status.FAILED)
        x = None if says.x is None else native.posed.restore(np.asarray(says.x, float))
        if x is not None and not np.isfinite(x).all():
            x = None
        if x is None and status is Status.SOLVED:
            status = Status.FAILED
        text = str(getattr(says.status, "name", says.status))
        return Answer(x, status, says.iterations, text, memory=Carried(native, says.duals))

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """Solve `qp`; where every row is fixed (or k = 0) there is nothing to hand to a package."""
        if (qp.lower == qp.upper).all():
            x = qp.lower.copy()
            return Solution(x, qp.row_id, Status.SOLVED, working_set_of(qp, x), 0, "all rows fixed")
        return super().solve(qp, start)


def _carried_duals(carried: Carried, posed: Posed) -> Vector:
    """Δ of the previous solve in today's scale, Δ = force²/unit · Δ̂.  (n,)"""
    assert carried.duals is not None
    duals, old = np.zeros(posed.n), carried.native.posed
    place = positions_of(posed.rows, old.rows)
    known = place >= 0
    was = place[known]
    rescale = (old.force / posed.force) ** 2 * (posed.unit[known] / old.unit[was])
    duals[known] = carried.duals[was] * rescale
    return duals


def _bound_multipliers(posed: Posed) -> Vector:
    """−Δ at the start, of rows at a bound where its sign is right; 0 elsewhere.  (n,)"""
    x, members = posed.start, posed.working_set
    assert x is not None and members is not None
    duals = -(posed.q + posed.A.T @ (posed.A @ x))
    right = ((members == AT_LOWER) & (duals < 0)) | ((members == AT_UPPER) & (duals > 0))
    return np.where(right, duals, 0.0)


def same_pattern(one: Any, other: Any) -> bool:
    """Whether two matrices are stored alike: both dense, or both CSC with the same pattern."""
    if one.shape != other.shape or sp.issparse(one) != sp.issparse(other):
        return False
    if not sp.issparse(one):
        return True
    return np.array_equal(one.indptr, other.indptr) and np.array_equal(one.indices, other.indices)


def same_matrix(one: sp.csc_matrix, other: sp.csc_matrix) -> bool:
    """Whether two CSC matrices are equal, entry by stored entry."""
    return same_pattern(one, other) and np.array_equal(one.data, other.data)
