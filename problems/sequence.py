"""The sequence of QPs that a simulation poses: solved by the solver it was handed, and kept.

Warm starts follow the protocol of the replay: a step, iteration or corrector QP starts from the
last solution of that group unless the integration has just restarted; impulses and minimum-norm
QPs start cold.  An answer from a warm start that its solver does not call solved is asked for
once more, cold.

This differs from the protocol: the minimum-norm QPs of many columns say which of their like they
continue (`chain`), because from a cold start their search takes longer than all else.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from problems.qp import ContactQP, Solution, Status
from problems.qp_kernel import CompiledMethod

if TYPE_CHECKING:
    from problems.stepping.run import Simulated

WARM_KINDS = ("step", "iteration", "corrector")
"""Kinds of QP that end a step; they follow one another smoothly enough for a warm start."""


class SolvesQPs(Protocol):
    """All that a simulation asks of a solver."""

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution: ...


class SimulationError(RuntimeError):
    """A simulation that cannot go on; the message says when, where and what to try.

    run : the motion until then, see `problems.simulate`
    """

    run: Simulated | None = None


class QPSequence:
    """Poses, solves and keeps QPs; those of a step are marked accepted when the step is.

    keep : whether they are kept;  count : how many there were
    """

    def __init__(self, solver: SolvesQPs, keep: bool = True):
        self.solver, self.keep, self.count = solver, keep, 0
        self.qps: list[ContactQP] = []
        self.solutions: list[Solution] = []
        self._last: Solution | None = None
        self._chains: dict[str, Solution] = {}
        self._restarting = True
        self._settled = 0

    def restart(self) -> None:
        """The next time step follows a discontinuity."""
        self._restarting = True

    def start(self) -> Solution | None:
        """What the next step's QP starts from."""
        return None if self._restarting else self._last

    def compiled(self, k: int) -> CompiledMethod | None:
        """The solver's method for compiled steps with QPs of up to k columns.

        None where QPs are kept, or where it has none.
        """
        offer = None if self.keep else getattr(self.solver, "compiled", None)
        return None if offer is None else offer(k)

    def went_on(self, last: Solution, count: int) -> None:
        """So many more QPs of steps were solved elsewhere, with this last solution."""
        self._last, self._restarting = last, False
        self.count += count

    def solve(
        self, *, own: bool = False, chain: str = "", **fields: Any
    ) -> tuple[ContactQP, Solution]:
        """Pose the QP with these fields of `ContactQP` and solve it.

        own : the fields are all there, and fit for `ContactQP.of_own`
        chain : where a QP would start cold: start from the last one of this name, and be the next

        Raises `SimulationError` where the solver gives no x, or something that is no answer.
        """
        warm = fields["kind"] in WARM_KINDS
        first = warm and self._restarting
        pose = ContactQP.of_own if own else ContactQP
        qp = pose(**fields, accepted=False, restart=first)
        start = self.start() if warm else self._chains.get(chain)
        solution = self._ask(qp, start)
        near = chain != "" and solution.status is Status.INACCURATE  # who asks looks at it himself
        if start is not None and not solution.found and not near:
            solution = self._ask(qp, None)
        if solution.x is None:
            said = solution.status_text or solution.status.value
            raise SimulationError(
                f"t = {qp.t:.6g}: the solver gave no answer to a {qp.kind} QP with {qp.k} columns "
                f"({solution.status.name.lower()}: {said}); try another solver"
            )
        self.count += 1
        if self.keep:
            self.qps.append(qp)
            # what a solver wants back goes to its successor only: it may be far larger than x
            self.solutions.append(solution.without_memory())
        if warm:
            self._restarting = False
            self._last = solution
        elif chain:
            self._chains[chain] = solution
        return qp, solution

    def _ask(self, qp: ContactQP, start: Solution | None) -> Solution:
        """The solver's answer; whatever it does wrong becomes a `SimulationError` that says so."""
        try:
            solution = self.solver.solve(qp, start)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}, line {where.lineno}"
            raise _crime(qp, f"raised {type(error).__name__}: {error} ({place})") from error
        if not isinstance(solution, Solution):
            raise _crime(qp, f"returned {type(solution).__name__}, not a Solution")
        x = solution.x
        if x is not None and not (x.shape == (qp.k,) and np.isfinite(x).all()):
            raise _crime(qp, f"returned an x that is not {qp.k} finite numbers")
        return solution

    def settle(self, accepted: bool) -> None:
        """Everything solved since the last call belongs to a step that was accepted or rejected."""
        if accepted:
            for i in range(self._settled, len(self.qps)):
                self.qps[i] = self.qps[i].as_accepted()
        self._settled = len(self.qps)


def _crime(qp: ContactQP, what: str) -> SimulationError:
    return SimulationError(
        f"t = {qp.t:.6g}: a {qp.kind} QP with {qp.k} columns: the solver {what}; "
        "try another solver, or mend this one"
    )
