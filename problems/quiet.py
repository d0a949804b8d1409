"""Steps in which nothing happens, handed to a solver that can take them by itself.

Between events a step is always the same: AB-r, columns, one QP, BDF-r, the length of the next.  A
solver whose QPs are solved in compiled code may offer `take_quiet_steps`, a loop over such steps
that ends where the stepper is needed.  What it does is what `Stepper.advance` does, up to rounding;
here is what both must agree on.  It is for runs whose QPs are not kept, with forces that are
constant between their jumps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from problems.constraint_graph import ActiveSet
from problems.contacts import Geometry
from problems.multistep import asked_accuracy
from problems.qp import Indices, Solution, Vector
from problems.run import Multipliers

if TYPE_CHECKING:
    from problems.system import System

MOST = 256
"""Steps of one call."""

# rows of `QuietSteps.state`
Q, V, V_BEFORE, A, A_BEFORE = range(5)
# entries of `QuietSteps.reals`: the time, the last step and the one wished for [s] …
TIME, H, WISH = range(3)
# … and what the stepper is set to
EPS, DROP_TOL, H_MAX, FIXED, REST_SPEED, UNTIL, REACH, CONTACT_TOL = range(3, 11)
# entries of `QuietSteps.counts`: steps since the last restart, steps taken, QPs solved, those of
# them that belong to steps taken or rejected, highest order, why there were no more, time points
# with λ, corrected friction, steps rejected because their error turned out too large, whether
# nothing happens at UNTIL
STEPS, TAKEN, SOLVES, COUNTED, HIGHEST, ENDED, KNOWN, CORRECTED, REJECTED, OPEN = range(10)
# values of `counts[ENDED]`: the next step is the stepper's, it has to look at the last one first,
# the candidates have to be listed anew
EVENT, LOOK, STALE = range(3)


class Shapes(NamedTuple):
    """The arrays of a `Geometry` that kernels need."""

    corner_body: Indices
    corner_part: Indices
    corner_local: Vector
    part_body: Indices
    edge_normal: Vector
    edge_offset: Vector
    edge_start: Vector
    edge_length: Vector
    radius: Vector

    @classmethod
    def of(cls, geometry: Geometry) -> Shapes:
        return cls(*(getattr(geometry, name) for name in cls._fields))


class QuietSteps(NamedTuple):
    """What steps are taken with, and what they leave behind.

    For n bodies, N active normals, F frictions, and QPs of k columns.

    D : (3n,);  forces : (3n,) f;  eps0 : the accuracy asked of a QP (3.13)
    place : (N, 3) corner, part, edge;  friction_of : (N,);  first, mu : (F,), see `ActiveSet`
    signs : (F,) s of those that slide, 0 of those that stick
    row, tangential, row_id : (k,), the last read only;  normal_column : (N,);  sticking,
        sticking_column : of those that stick;  see `Layout`
    lam, lam_before : (N,) λ_N at the last two time points, updated
    corner, part, level, free : (L,) the candidates themselves, whose levels are updated
    listed_at : (3n,) where the candidates were listed
    state, reals, counts : see the names above, updated
    track : (MOST, 1 + 6n) t, q, q̇ of every step;  gaps : (MOST,) min φ [m]
    multipliers : (MOST, N + F) λ
    """

    shapes: Shapes
    D: Vector
    forces: Vector
    eps0: float
    place: Indices
    friction_of: Indices
    first: Indices
    mu: Vector
    signs: Vector
    row: Indices
    tangential: NDArray[np.bool_]
    row_id: Indices
    normal_column: Indices
    sticking: Indices
    sticking_column: Indices
    lam: Vector
    lam_before: Vector
    corner: Indices
    part: Indices
    level: Vector
    free: NDArray[np.bool_]
    listed_at: Vector
    state: Vector
    reals: Vector
    counts: Indices
    track: Vector
    gaps: Vector
    multipliers: Vector


class TakesQuietSteps(Protocol):
    """A solver with a compiled loop over steps, and compiled minimum-norm multipliers."""

    def take_quiet_steps(self, run: QuietSteps, start: Solution | None) -> Solution | None:
        """Take steps until the stepper is needed; the last solution, None without any."""


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The same memory, not to be written to, as kernels want what a QP consists of."""
    view = array.view()
    view.setflags(write=False)
    return view


class Quiet:
    """Leaves the quiet steps of a stepper to its solver, unless it is known to take none."""

    def __init__(self, stepper: System) -> None:
        solver: Any = stepper.qps.solver
        able = hasattr(solver, "take_quiet_steps") and not stepper.qps.keep
        able &= stepper.options.drift == "none" and not stepper.varying
        self.solver: TakesQuietSteps | None = solver if able else None
        self._event_is_next = False

    def take_steps(self, stepper: System, end: float) -> bool:
        """Let the solver take steps from here to `end` [s]; whether it took any.

        The stepper is left as it is after the last of them, before step 4.
        """
        if self.solver is None:
            return False
        active = stepper.graph.active_set()
        if not self._may_take_any(stepper, active):
            return False
        taken, ended = 0, STALE
        while ended == STALE:
            run = _prepare(stepper, active, end)
            solution = self.solver.take_quiet_steps(run, stepper.qps.start())
            steps, rejected, solved, ended = run.counts[[TAKEN, REJECTED, COUNTED, ENDED]].tolist()
            if solution is not None:
                stepper.qps.went_on(solution, solved)
                stepper.counts["rejected_steps"] += rejected
            if steps:
                _follow(stepper, run, active, steps)
            taken += steps
        self._event_is_next = taken > 0 and ended != LOOK
        return taken > 0

    def _may_take_any(self, stepper: System, active: ActiveSet) -> bool:
        event, self._event_is_next = self._event_is_next, False
        if event:
            return False
        # (4.4) is computed by the stepper where it is no mere guess
        guessed = stepper.options.friction == "corrected" or not active.frictions
        return stepper.lam_known > 0 or guessed


def _prepare(stepper: System, active: ActiveSet, end: float) -> QuietSteps:
    graph, history, options = stepper.graph, stepper.history, stepper.options
    until = min([*stepper.scheduled(), end])
    near = graph.candidates
    near.renew(stepper.q, active.place)
    state = np.zeros((5, stepper.q.size))
    state[[Q, V, V_BEFORE]] = stepper.q, history.v, history.v_before
    for row, a in zip((A, A_BEFORE), history.a, strict=False):
        state[row] = a
    signs = np.array([friction.sign for friction in active.frictions], dtype=np.float64)
    layout = active.layout(signs)
    corrected = options.friction == "corrected" and signs.size > 0
    return QuietSteps(
        shapes=stepper.shapes,
        D=stepper.D,
        # constant on the way, but one may begin or end at t itself
        forces=stepper.force(stepper.q, history.v, 0.5 * (stepper.t + until)),
        eps0=asked_accuracy(options.eps, corrected),
        place=active.place,
        friction_of=active.friction_of,
        first=active.first,
        mu=active.mu,
        signs=signs,
        row=layout.row,
        tangential=layout.tangential,
        row_id=layout.row_id,
        normal_column=layout.normal_column,
        sticking=layout.sticking,
        sticking_column=layout.sticking_column,
        lam=active.lam[0].copy(),
        lam_before=active.lam[1].copy(),
        corner=near.corner,
        part=near.part,
        level=near.level,
        free=near.free,
        listed_at=near.listed_at,
        state=state,
        reals=np.array(
            [
                *(stepper.t, history.h, stepper.h_last),
                *(options.eps, options.drop_tol, options.h_max, options.fixed_step or 0.0),
                *(options.rest_speed, until, near.margin / 2, graph.geometry.contact_tol),
            ]
        ),
        counts=np.array(
            [
                *(history.steps, 0, 0, 0, history.highest, EVENT),
                *(stepper.lam_known, int(corrected), 0, int(until == end)),
            ]
        ),
        track=np.empty((MOST, 1 + 2 * stepper.q.size)),
        gaps=np.empty(MOST),
        multipliers=np.empty((MOST, len(active.normals) + signs.size)),
    )


def _follow(stepper: System, run: QuietSteps, active: ActiveSet, taken: int) -> None:
    """Bring the stepper to where the run has come."""
    m = stepper.q.size
    multipliers = run.multipliers[:taken]
    active.lam[:] = run.lam, run.lam_before
    n = active.normal_ids.size
    for row, lam, gap in zip(run.track, multipliers, run.gaps.tolist(), strict=False):
        rows = Multipliers(active.normal_ids, active.friction_ids, lam[:n], lam[n:])
        stepper.states.append((float(row[0]), row[1 : 1 + m], row[1 + m :], rows, gap))
    stepper.t, h, stepper.h_last = run.reals[[TIME, H, WISH]].tolist()
    stepper.q = run.state[Q]
    steps = int(run.counts[STEPS])
    a = [run.state[A], run.state[A_BEFORE]][:steps]
    stepper.history.resume(run.state[V], run.state[V_BEFORE], a, h, steps)
    stepper.lam_known = int(run.counts[KNOWN])
    stepper.counts["steps"] += taken
