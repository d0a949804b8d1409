"""What a solver is: immutable settings and one method, `solve(qp, start=None) → Solution`.

A solver of the project is a frozen dataclass that derives from `Solver` and fills in four stages:

    build   A, d, bounds → arrays in the package's own form          (timed as build)
    setup   a fresh native object, or an update of the previous one  (timed as setup)
    run     the package's own call and nothing else                  (timed as solve)
    read    the package's answer → x, status, iterations             (not timed)

`solve` drives them with a clock read between each, so that wrapper work is never counted as the
package's.  There is no hidden state: what a solver wants to remember travels in `Solution.memory`
and comes back, mapped by `row_id`, as a `Start`.
"""

from __future__ import annotations

import abc
import time
from dataclasses import dataclass
from math import nan
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from problems.qp import (
    AT_LOWER,
    AT_UPPER,
    FREE,
    ContactQP,
    Solution,
    Status,
    Timing,
    Vector,
    WorkCounts,
    positions_of,
    working_set_of,
)

Form = Literal["least_squares", "normal", "residual", "velocity"]
"""How a backend is posed the QP: min ½‖Ax+d‖² directly; P = AᵀA, which squares the condition;
min ½‖y‖² with y = A x + d as rows; or the strictly convex velocity problem (3.4)."""


class Unsupported(Exception):
    """A QP that a solver cannot take, with the reason; the harness records it as skipped."""


class Start(NamedTuple):
    """An earlier solution, mapped by `row_id` onto the rows of today's QP.

    x : (k,) old x clipped to today's bounds; new rows start at 0, clipped likewise
    working_set : (k,) int8, FREE for new rows and where the bound that was reached is no longer
    previous : (k,) int64, position of each row in the old QP or −1
    memory : what the solver left in `Solution.memory`
    """

    x: Vector
    working_set: NDArray[np.int8]
    previous: NDArray[np.int64]
    memory: Any


class Answer(NamedTuple):
    """What `read` makes of a package's result.

    inside : [s] what the package's own clock says of setup and solve, NaN where it has none
    """

    x: Vector | None
    status: Status
    iterations: int = 0
    status_text: str = ""
    working_set: NDArray[np.int8] | None = None
    work: WorkCounts | None = None
    memory: Any = None
    inside: float = nan


def usable(start: Solution | None) -> Solution | None:
    """`start`, or None where it holds no finite x."""
    if start is None or start.x is None or not np.isfinite(start.x).all():
        return None
    return start


def started(start: Solution | None) -> Start | None:
    """What is known of a usable solution, its rows as they were."""
    known = usable(start)
    if known is None or known.x is None:
        return None
    return Start(known.x, known.working_set, known.row_id, known.memory)


def carry_over(start: Start, qp: ContactQP) -> Start:
    """Map a start whose rows are as they were onto the rows of `qp` by `row_id`."""
    x, members, before = start.x, start.working_set, start.previous
    if before is not qp.row_id and before.tobytes() != qp.row_id.tobytes():
        before = positions_of(qp.row_id, before)
        known = before >= 0
        x, members = np.zeros(qp.k), np.full(qp.k, FREE, dtype=np.int8)
        x[known] = start.x[before[known]]
        members[known] = start.working_set[before[known]]
    else:
        before = np.arange(qp.k)
    gone = ((members == AT_LOWER) & (qp.lower == -np.inf)) | (
        (members == AT_UPPER) & (qp.upper == np.inf)
    )
    if np.count_nonzero(gone):
        members = np.where(gone, FREE, members).astype(np.int8)
    return Start(np.minimum(np.maximum(x, qp.lower), qp.upper), members, before, start.memory)


@dataclass(frozen=True)
class Solver(abc.ABC):
    """Immutable settings of one QP method.

    accuracy : absolute in ‖A δx‖ like ε₀ in (3.13); None: each QP's own `eps0`;
        "default": the package's default tolerances, whatever they mean

    Raises ValueError for another `accuracy`, as derived classes do for a `variant` they lack.
    """

    accuracy: float | Literal["default"] | None = None

    name: ClassVar[str]
    """Name on the command line and in tables."""
    package: ClassVar[str] = ""
    """Distribution that does the work, for its version; empty for our own."""
    form: ClassVar[Form] = "normal"
    forms: ClassVar[tuple[str, ...]] = ()
    """The forms that it can be posed as variants, `name[form]`; none where there is no choice."""
    variants: ClassVar[tuple[str, ...]] = ()
    """What `name[variant]` may be beside `forms`."""
    warm_start: ClassVar[str] = "none"
    """What a warm start carries: "none", "x", "x and y", "working set", "factorisation", …"""
    maps_rows: ClassVar[bool] = False
    """Whether the solver maps rows itself; then a `Start` holds the old x and working set as they
    are, and `previous` the old `row_id`."""
    regularisation: ClassVar[str] = "none"
    """Anything that the adapter or the package's required settings add to the problem."""

    def __post_init__(self) -> None:
        if self.accuracy is None or self.accuracy == "default":
            return
        if not (isinstance(self.accuracy, (int, float)) and 0 < self.accuracy < np.inf):
            raise ValueError(
                f"accuracy = {self.accuracy!r}; give a positive number in ‖A δx‖, "
                "None for each QP's own eps0, or \"default\" for the package's tolerances"
            )

    def asked(self, qp: ContactQP) -> float | None:
        """Accuracy asked for this QP in ‖A δx‖, or None for the package's defaults."""
        if self.accuracy == "default":
            return None
        return qp.eps0 if self.accuracy is None else float(self.accuracy)

    @abc.abstractmethod
    def build(self, qp: ContactQP, start: Start | None) -> Any:
        """Bring A, d and the bounds into the package's form."""

    @abc.abstractmethod
    def setup(self, problem: Any, asked: float | None, start: Start | None) -> Any:
        """Make the package's native object, or update the one in `start.memory`."""

    @abc.abstractmethod
    def run(self, native: Any) -> Any:
        """The package's own solve call and nothing else."""

    @abc.abstractmethod
    def read(self, qp: ContactQP, native: Any, result: Any) -> Answer:
        """Turn the package's result into an `Answer`."""

    def adopt(self, memory: Any, start: Solution) -> Any:
        """`memory` of this solver's last solution, made to agree with a start that is another.

        x and the working set of `start` count, and nothing that `memory` says about them.  It may
        be changed in place, and serves one successor as ever.  None: nothing of it can be used.
        """
        return None

    def solve_arrays(
        self,
        A: ArrayLike | sp.sparray,
        d: ArrayLike,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        row_id: ArrayLike | None = None,
        start: Solution | None = None,
        t: float = 0.0,
        eps0: float = 1e-9,
    ) -> Solution:
        """Solve min ½‖A x + d‖², lower ≤ x ≤ upper, warm from `start` or cold, by one call.

        A (m, k) dense or sparse, d (m,), lower and upper (k,), row_id (k,), t, eps0 : as of
            `ContactQP`; arrays are not kept

        Raises ValueError for what a `ContactQP` refuses, and `Unsupported` as `solve` does.
        """
        return self.solve(ContactQP(A, d, lower, upper, row_id, t=t, eps0=eps0), start)

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """Solve `qp`, warm from `start` (an earlier Solution of this solver) or cold.

        Raises `Unsupported` for a QP that this method cannot take; a solve that fails does not
        raise, it returns its `Status`.
        """
        warm = started(start)
        if warm is not None and not self.maps_rows:
            warm = carry_over(warm, qp)
        clock, asked = time.perf_counter, self.asked(qp)
        t0 = clock()
        problem = self.build(qp, warm)
        t1 = clock()
        native = self.setup(problem, asked, warm)
        t2 = clock()
        result = self.run(native)
        t3 = clock()
        answer = self.read(qp, native, result)
        x, status = answer.x, answer.status
        if x is not None:
            x = np.array(x, dtype=np.float64)
            if x.shape != (qp.k,):
                raise ValueError(f"{self.name} returned x of shape {x.shape}; expected ({qp.k},)")
        members = answer.working_set
        if members is None:
            members = np.zeros(qp.k, np.int8) if x is None else working_set_of(qp, x)
        return Solution(
            x=x,
            row_id=qp.row_id,
            status=status,
            working_set=members,
            iterations=int(answer.iterations),
            status_text=answer.status_text,
            work=answer.work,
            timing=Timing(t1 - t0, t2 - t1, t3 - t2, answer.inside if self.package else t3 - t2),
            memory=answer.memory,
        )
