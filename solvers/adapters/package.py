"""What adapters of packages share: native objects kept and updated, answers read."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

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
from solvers.adapters.posed import FORCES, Posed, pose
from solvers.base import Answer, Solver, Start, carry_over


class Native(NamedTuple):
    """A package's object, ready to run, with the problem that it holds and its settings."""

    posed: Posed
    object: Any
    arrays: Any = None
    options: Any = None


class Carried(NamedTuple):
    """`Solution.memory` of a package: its object and duals, for the next solve.

    Without duals they are those of the x that is started from.
    """

    native: Native
    duals: Vector | None = None


class Built(NamedTuple):
    """What `build` hands to `setup`: nothing is left to do there but to call the package.

    posed : the problem
    arrays : the package's form of it, see `PackageSolver.arrays`
    options : the package's settings for it, see `PackageSolver.options`
    carried : what the previous solve left, if it had the same unknowns in the same order
    duals : (n,) its multipliers of the bounds in today's units, 0 for new rows, or those that
        belong to a start that comes without memory; None when cold, or where the object has them
    guess : z and y that belong to the start in the form of a `programs.ProgramSolver`
    """

    posed: Posed
    arrays: Any
    options: Any = None
    carried: Carried | None = None
    duals: Vector | None = None
    guess: tuple[Vector, Vector] | None = None


class Outcome(NamedTuple):
    """What a package says.

    x : unknowns as they were posed, at least n of them, or None;  status : the package's own
    duals : (n,) multipliers of the bounds of them, in the package's sign
    inside : [s] what its own clock says of setup and solve, NaN where it has none
    """

    x: Vector | None
    status: Any
    iterations: int = 0
    duals: Vector | None = None
    inside: float = nan


@dataclass(frozen=True)
class PackageSolver(Solver, abc.ABC):
    """A solver that is posed problems without fixed rows, see `Posed`.

    Derived classes write `arrays`, `setup`, `run` and `outcome`, and the table `statuses`.
    """

    maps_rows: ClassVar[bool] = True
    dense: ClassVar[bool] = False
    """Whether the package takes dense matrices only."""
    forces: ClassVar[tuple[float, float]] = FORCES
    """Sizes of what acts that it is posed as they are (`posed.pose`)."""
    one_sided_forces: ClassVar[tuple[float, float] | None] = None
    """The same where x ≥ 0 is all that is asked, if they are others."""
    takes_duals: ClassVar[bool] = True
    """Whether multipliers of the bounds go with an x that is started from."""
    statuses: ClassVar[dict[Any, Status]] = {}
    """The package's statuses; one that is not here is FAILED, with its text kept."""

    @abc.abstractmethod
    def arrays(self, posed: Posed) -> Any:
        """The problem in the package's own form."""

    def options(self, posed: Posed, asked: float | None) -> Any:
        """The package's settings for an error of `asked` in ‖A δx‖; None: its defaults."""

    @abc.abstractmethod
    def outcome(self, native: Native, result: Any) -> Outcome:
        """What the package says."""

    def in_x(self, native: Native, says: Outcome) -> Outcome:
        """What the package says, of the unknowns of `Posed`, where it was posed others."""
        return says

    def build(self, qp: ContactQP, start: Start | None) -> Built:
        """Pose the QP and bring it into the package's form."""
        posed = pose(qp, self.dense, self.forces, self.one_sided_forces)
        options = self.options(posed, self.asked(qp))
        if start is None:
            return Built(posed, self.arrays(posed), options)
        carried, duals = self._carried(qp, posed, start)
        arrays = self.arrays(posed)
        if carried is not None and carried.native.posed.form != posed.form:
            carried = None
        guess = None if duals is None else self.guess(posed, duals)
        return Built(posed, arrays, options, carried, duals, guess)

    def starts_anew(self, posed: Posed) -> bool:
        """Whether an object that holds no earlier problem can be given a start."""
        return True

    def guess(self, posed: Posed, duals: Vector) -> Any:
        """What a package starts from, where that is more than x and multipliers of its bounds."""

    def _carried(
        self, qp: ContactQP, posed: Posed, start: Start
    ) -> tuple[Carried | None, Vector | None]:
        """What of a start can be gone on from; its x is put into `posed` where it is wanted."""
        memory = start.memory if isinstance(start.memory, Carried) else None
        carried = None
        if memory is not None and memory.native.posed.is_like(posed):
            carried = memory
        if self.warm_start in ("none", "workspace"):
            return carried, None
        if carried is not None and carried.duals is not None and self.goes_on(carried, posed):
            posed.before = carried.native
            return carried, None
        if carried is None and not self.starts_anew(posed):
            return None, None
        started = carry_over(start, qp)
        posed.to_posed(started.x, started.working_set)
        duals = None
        if not self.takes_duals:
            return carried, None
        if memory is not None and memory.duals is not None:
            duals = _carried_duals(memory, posed)
        elif (started.previous >= 0).any():
            duals = _bound_multipliers(posed)
        return carried, duals

    def goes_on(self, carried: Carried, posed: Posed) -> bool:
        """Whether the object of the previous solve itself holds what it ended with, in units that
        are today's."""
        return carried.native.posed.units is None and posed.units is None

    def adopt(self, memory: Any, start: Solution) -> Any:
        """The package's object; the multipliers will be those of `start`."""
        return Carried(memory.native) if isinstance(memory, Carried) else None

    def read(self, qp: ContactQP, native: Native, result: Any) -> Answer:
        """Map the package's result by the table of statuses."""
        says = self.in_x(native, self.outcome(native, result))
        native.posed.forget()
        status = self.statuses.get(says.status, Status.FAILED)
        x = None if says.x is None else native.posed.restore(np.asarray(says.x, float))
        if x is not None and not isfinite(x.sum()):
            x = None
        if x is None and status is Status.SOLVED:
            status = Status.FAILED
        text = str(getattr(says.status, "name", says.status))
        memory = Carried(native, says.duals)
        return Answer(x, status, says.iterations, text, memory=memory, inside=says.inside)

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """Solve `qp`; where every row is fixed (or k = 0) there is nothing to hand to a package."""
        if qp.k == 0 or (qp.lower[0] == qp.upper[0] and (qp.lower == qp.upper).all()):
            x = qp.lower.copy()
            return Solution(x, qp.row_id, Status.SOLVED, working_set_of(qp, x), 0, "all rows fixed")
        return super().solve(qp, start)


def _carried_duals(carried: Carried, posed: Posed) -> Vector:
    """Δ of the previous solve in today's units, Δ = force²/unit · Δ̂.  (n,)"""
    assert carried.duals is not None
    duals, old = np.zeros(posed.n), carried.native.posed
    place = positions_of(posed.rows, old.rows)
    known = place >= 0
    was = place[known]
    duals[known] = carried.duals[was] * dual_units(old)[was] / dual_units(posed)[known]
    return duals


def dual_units(posed: Posed) -> Vector:
    """Δ of the QP over that of the posed problem.  (n,)"""
    if posed.units is None:
        return np.ones(posed.n)
    return np.full(posed.n, posed.units.force**2 / posed.units.unit)


def _bound_multipliers(posed: Posed) -> Vector:
    """−Δ at the start, of rows at a bound where its sign is right; 0 elsewhere.  (n,)"""
    x, members = posed.start, posed.working_set
    assert x is not None and members is not None
    duals = -(posed.q + posed.A.T @ (posed.A @ x))
    right = ((members == AT_LOWER) & (duals < 0)) | ((members == AT_UPPER) & (duals > 0))
    return np.where(right, duals, 0.0)


def change(settings: Any, options: dict[str, Any], before: Native | None) -> None:
    """Set what differs from the settings that the object had before; all of a new one."""
    had = {} if before is None else before.options
    for name, value in options.items():
        if had.get(name) != value:
            setattr(settings, name, value)


def same_pattern(one: Any, other: Any) -> bool:
    """Whether two matrices are stored alike: both dense, or both CSC with the same pattern."""
    if one is other:
        return True
    if type(one) is not type(other) or one.shape != other.shape:
        return False
    if not sp.issparse(one):
        return True
    return _same(one.indptr, other.indptr) and _same(one.indices, other.indices)


def _same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return one is other or np.array_equal(one, other)


def same_kind(one: Any, other: Any) -> bool:
    """Whether two arguments of a package are both left out, or stored alike."""
    if one is None or other is None:
        return one is other
    return same_pattern(one, other)


def same_matrix(one: sp.csc_matrix, other: sp.csc_matrix) -> bool:
    """Whether two CSC matrices are equal, entry by stored entry."""
    return same_pattern(one, other) and np.array_equal(one.data, other.data)
