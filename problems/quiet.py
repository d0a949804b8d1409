"""What a run whose QPs are not kept leaves to a solver that does it in compiled code.

Between events a step is always the same: AB-r, columns, passes of QPs, BDF-r, the length of the
next.  A solver may offer `take_quiet_steps`, a loop over such steps that ends where the stepper is
needed: at a collision, at an end of an edge, after a step with which a contact separates, stops or
begins to slip.  What it does is what `Stepper.advance` does, up to rounding, and with more columns
than the solver has a path of its own for, up to the accuracy asked of QPs.  Here is what both must
agree on.  Forces must be constant between their jumps.

It may offer `newton_coulomb`, the passes of a `Collision`, and `least_norm` (4.8), too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from problems.assembly import Assembly
from problems.constraint_graph import ActiveSet
from problems.contacts import Geometry
from problems.multistep import asked_accuracy
from problems.qp import Indices, Solution, Vector
from problems.run import Multipliers
from problems.velocity import MAX_PASSES, VelocityStep

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
# with λ, passes of friction at most (1: lagged), steps rejected because their error turned out too
# large or friction stops, whether nothing happens at UNTIL, passes of the last step, whether steps
# are cut where friction stops
STEPS, TAKEN, SOLVES, COUNTED, HIGHEST, ENDED, KNOWN, MOST_PASSES, REJECTED, OPEN = range(10)
PASSES, CUTS = 10, 11
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


class Frictions(NamedTuple):
    """Which normals bound which frictions, and the columns of the QP of both.

    For N normals, F frictions, of which S stick, and k columns; see `ActiveSet` and `Layout`.

    friction_of : (N,);  first, mu : (F,)
    signs : (F,) s of those that slide, 0 of those that stick
    row, tangential, row_id : (k,), the last read only
    normal_column : (N,);  sticking, sticking_column : (S,)
    """

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

    @classmethod
    def of(cls, active: ActiveSet, mu: Vector, signs: Vector) -> Frictions:
        """Those of J_N and J_F with the coefficients mu (F,)."""
        layout = active.layout(signs)
        return cls(
            *(active.friction_of, active.first, mu, signs),
            *(layout.row, layout.tangential, layout.row_id),
            *(layout.normal_column, layout.sticking, layout.sticking_column),
        )


class QuietSteps(NamedTuple):
    """What steps are taken with, and what they leave behind.

    For n bodies, N active normals, F frictions, and QPs of k columns.

    D : (3n,);  forces : (3n,) f;  eps0 : the accuracy asked of a QP (3.13)
    place : (N, 3) corner, part, edge;  frictions : see there
    lam, lam_before : (N,) λ_N at the last two time points, updated
    corner, part, level, free : (L,) the candidates themselves, whose levels are updated
    listed_at : (3n,) where the candidates were listed
    state, reals, counts : see the names above, updated
    track : (MOST, 1 + 6n) t, q, q̇ of every step;  gaps : (MOST,) min φ [m]
    multipliers : (MOST, N + F) λ
    at_bound, stopped : (F,) of the last step: `VelocityStep.at_bound`, whether a sliding one stops
    """

    shapes: Shapes
    D: Vector
    forces: Vector
    eps0: float
    place: Indices
    frictions: Frictions
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
    at_bound: NDArray[np.bool_]
    stopped: NDArray[np.bool_]


class Collision(NamedTuple):
    """What Newton–Coulomb impulses follow from, see `problems.newton_coulomb`.

    D, v, F : (3n,) with q̇₋ = v and the external impulse
    columns, layout, tangents : (entries (·, 6), bodies (·, 2)) of g_N, of the QP and of g_F
    """

    frictions: Frictions
    D: Vector
    v: Vector
    F: Vector
    columns: tuple[Vector, Indices]
    layout: tuple[Vector, Indices]
    tangents: tuple[Vector, Indices]


class Impact(NamedTuple):
    """q̇₊ (3n,), Λ_N (N,), Λ_F (F,), and the QPs that were solved for them."""

    v: Vector
    lam_N: Vector
    lam_F: Vector
    solves: int


class LastStep(NamedTuple):
    """The last of so many `steps`, s (F,) of its frictions, and whether they stop at its end."""

    step: VelocityStep
    signs: Vector
    stopped: NDArray[np.bool_]
    steps: int


class TakesQuietSteps(Protocol):
    """A solver with a compiled loop over steps."""

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

    def take_steps(self, stepper: System, end: float) -> LastStep | None:
        """Let the solver take steps from here to `end` [s]; the last of them, None without any.

        The stepper is left as it is after that, before step 4.
        """
        if self.solver is None:
            return None
        active = stepper.graph.active_set()
        if not self._may_take_any(stepper, active):
            return None
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
                last = run
            taken += steps
        self._event_is_next = taken > 0 and ended != LOOK
        return _last_step(stepper, last, taken) if taken else None

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
    corrected = options.friction == "corrected" and signs.size > 0
    return QuietSteps(
        shapes=stepper.shapes,
        D=stepper.D,
        # constant on the way, but one may begin or end at t itself
        forces=stepper.force(stepper.q, history.v, 0.5 * (stepper.t + until)),
        eps0=asked_accuracy(options.eps, corrected),
        place=active.place,
        frictions=Frictions.of(active, active.mu, signs),
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
                *(stepper.lam_known, MAX_PASSES if corrected else 1, 0, int(until == end)),
                *(0, int(options.stops == "located")),
            ]
        ),
        track=np.empty((MOST, 1 + 2 * stepper.q.size)),
        gaps=np.empty(MOST),
        multipliers=np.empty((MOST, len(active.normals) + signs.size)),
        at_bound=np.zeros(signs.size, dtype=np.bool_),
        stopped=np.zeros(signs.size, dtype=np.bool_),
    )


def _last_step(stepper: System, run: QuietSteps, taken: int) -> LastStep:
    assembly, history = Assembly(stepper.graph, stepper.q), stepper.history
    normals = len(assembly.normals)
    lam_F = run.multipliers[run.counts[TAKEN] - 1, normals:]
    step = VelocityStep(
        h=history.h,
        q=stepper.q,
        v=history.v,
        a=history.a[0],
        lam_N=run.lam,
        lam_F=lam_F,
        gap_speed=assembly.gap_speed(history.v),
        slip_speed=assembly.slip_speed(history.v),
        at_bound=run.at_bound,
        assembly=assembly,
        passes=int(run.counts[PASSES]),
    )
    return LastStep(step, run.frictions.signs, run.stopped, taken)


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
