"""What a run whose QPs are not kept leaves to a solver that does it in compiled code.

Between events a step is always the same: AB-r, columns, passes of QPs, BDF-r, the length of the
next.  A solver may offer `take_quiet_steps`, a loop over such steps that ends where the stepper is
needed: at a collision, at an end of an edge, after a step with which friction stops.  What it does
is what `Stepper.advance` does, up to rounding, and with more columns than the solver has a path of
its own for, up to the accuracy asked of QPs.  Here is what both must agree on.  Forces must be
constant between their jumps.

It may offer `newton_coulomb`, the passes of a `Collision`, and `least_norm` (4.8), too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from problems.active_kernels import Contacts, Frictions
from problems.arena import Arena
from problems.assembly import Assembly
from problems.constraint_graph import ActiveSet
from problems.contacts import Geometry
from problems.multistep import asked_accuracy
from problems.qp import Indices, Solution, Vector
from problems.run import Stretch
from problems.velocity import MAX_PASSES, VelocityStep

if TYPE_CHECKING:
    from problems.system import System
    from problems.transitions import Transitions

MOST = 256
"""Steps of one call."""

# rows of `QuietSteps.state`
Q, V, V_BEFORE, A, A_BEFORE = range(5)
# entries of `QuietSteps.reals`: the time, the last step and the one wished for [s] …
TIME, H, WISH = range(3)
# … and what the stepper is set to, the overlap that is allowed last [m]
EPS, DROP_TOL, H_MAX, FIXED, REST_SPEED, UNTIL, REACH, ALLOWED = range(3, 11)
# entries of `QuietSteps.counts`: steps since the last restart, steps taken, QPs solved, those of
# them that belong to steps taken or rejected, highest order, why there were no more, time points
# with λ, passes of friction at most (1: lagged), steps rejected because their error turned out too
# large or friction stops, whether nothing happens at UNTIL, passes of the last step, whether steps
# are cut where friction stops, changes of the contacts
STEPS, TAKEN, SOLVES, COUNTED, HIGHEST, ENDED, KNOWN, MOST_PASSES, REJECTED, OPEN = range(10)
PASSES, CUTS, CHANGES = 10, 11, 12
ENTRIES = 13
# values of `counts[ENDED]`: the next step is the stepper's; it has to look at the last one first;
# there is no more room, or the candidates have to be listed anew; on the way, contacts have changed
EVENT, LOOK, AGAIN, CHANGED = range(4)


class Shapes(NamedTuple):
    """The arrays of a `Geometry` that kernels need."""

    corner_body: Indices
    corner_part: Indices
    corner_local: Vector
    part_body: Indices
    part_first: Indices
    part_size: Indices
    edge_normal: Vector
    edge_offset: Vector
    edge_start: Vector
    edge_length: Vector
    radius: Vector
    contact_tol: Vector

    @classmethod
    def of(cls, geometry: Geometry) -> Shapes:
        return cls(*(getattr(geometry, name) for name in cls._fields))


class QuietSteps(NamedTuple):
    """What steps are taken with, and what they leave behind.

    For n bodies and at first N active normals and F frictions, of which some leave on the way; what
    is left of arrays of these lengths is in front then.

    D : (3n,);  forces : (3n,) f;  eps0 : the accuracy asked of a QP (3.13)
    contacts : see there, multipliers and signs are updated
    corner, part, level, free : (L,) the candidates themselves, updated;  pairs : (P, 2) their parts
    listed_at : (3n,) where the candidates were listed
    state, reals, counts : see the names above, updated
    track : (MOST, 1 + 6n) t, q, q̇ of every step;  gaps : (MOST,) min φ [m]
    multipliers : (MOST, N + F) λ_N and λ_F
    at_bound, stopped : (F,) of the last step: `VelocityStep.at_bound`, whether a sliding one stops
    changes : (N + F, 2) steps taken and the row_id of a normal that left after them, or of a
        friction that began to slip
    sense : (N + F,) the sign s of that friction, 0 of a normal
    arena : room for what is made on the way
    """

    shapes: Shapes
    D: Vector
    forces: Vector
    eps0: float
    contacts: Contacts
    corner: Indices
    part: Indices
    level: Vector
    free: NDArray[np.bool_]
    pairs: Indices
    listed_at: Vector
    state: Vector
    reals: Vector
    counts: Indices
    track: Vector
    gaps: Vector
    multipliers: Vector
    at_bound: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    changes: Indices
    sense: Vector
    arena: Arena


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
    """A step that the stepper has to look at, s (F,) of its frictions, and whether they stop."""

    step: VelocityStep
    signs: Vector
    stopped: NDArray[np.bool_]


class TakesQuietSteps(Protocol):
    """A solver with a compiled loop over steps."""

    def take_quiet_steps(self, run: QuietSteps, start: Solution | None) -> Solution | None:
        """Take steps until the stepper is needed; the last solution, None without any."""


class Quiet:
    """Leaves the quiet steps of a stepper to its solver, unless it is known to take none."""

    def __init__(self, stepper: System) -> None:
        solver: Any = stepper.qps.solver
        able = hasattr(solver, "take_quiet_steps") and not stepper.qps.keep
        able &= stepper.options.drift == "none" and not stepper.varying
        self.solver: TakesQuietSteps | None = solver if able else None
        self._event_is_next = False
        if not able:
            return
        m, options = stepper.q.size, stepper.options
        self._state, self._counts = np.zeros((5, m)), np.zeros(ENTRIES, dtype=np.int64)
        self._track, self._gaps = np.empty((MOST, 1 + 2 * m)), np.empty(MOST)
        self._multipliers = np.empty(0)
        self._arena = Arena.of(0)
        self._reals = np.array(
            [
                *(0.0, 0.0, 0.0, options.eps, options.drop_tol, options.h_max),
                *(options.fixed_step or 0.0, options.rest_speed, 0.0),
                stepper.graph.candidates.margin / 2,
                stepper.allowed_overlap,
            ]
        )

    def take_steps(self, stepper: Transitions, end: float) -> tuple[int, LastStep | None]:
        """Let the solver take steps from here to `end` [s]: how many, and the last of them.

        The stepper is left as it is after that; before step 4, where the last step is given.
        """
        if self.solver is None:
            return 0, None
        if not self._may_take_any(stepper):
            return 0, None
        taken, ended = 0, AGAIN
        while ended == AGAIN:
            active = stepper.graph.active_set()
            run = self._prepare(stepper, active, end)
            solution = self.solver.take_quiet_steps(run, stepper.qps.start())
            counts = run.counts.tolist()
            steps, ended = counts[TAKEN], counts[ENDED]
            if solution is not None:
                stepper.qps.went_on(solution, counts[COUNTED])
                stepper.counts["rejected_steps"] += counts[REJECTED]
            if steps:
                _follow(stepper, run, active, steps)
                stepper.watch_progress()
            taken += steps
        self._event_is_next = taken > 0 and ended != LOOK
        return taken, _last_step(stepper, run) if ended == LOOK else None

    def _may_take_any(self, stepper: System) -> bool:
        event, self._event_is_next = self._event_is_next, False
        if event or stepper.gain_watch.failed:
            return False
        # (4.4) is computed by the stepper where it is no mere guess
        guessed = stepper.options.friction == "corrected" or not stepper.graph.frictions
        return stepper.lam_known > 0 or guessed

    def _prepare(self, stepper: System, active: ActiveSet, end: float) -> QuietSteps:
        graph, history, options = stepper.graph, stepper.history, stepper.options
        ahead = stepper.scheduled()
        until = min(ahead, end)
        near = graph.candidates
        near.renew(stepper.q, active.place)
        state, reals, counts = self._state, self._reals, self._counts
        state[Q], state[V], state[V_BEFORE] = stepper.q, history.v, history.v_before
        for row, a in zip((A, A_BEFORE), history.a, strict=False):
            state[row] = a
        reals[TIME], reals[UNTIL] = stepper.t, until
        reals[H], reals[WISH] = history.h, stepper.h_last
        signs = np.array([friction.sign for friction in active.frictions], dtype=np.float64)
        corrected = options.friction == "corrected" and signs.size > 0
        counts[:] = 0
        counts[STEPS], counts[HIGHEST] = history.steps, history.highest
        counts[KNOWN], counts[MOST_PASSES] = stepper.lam_known, MAX_PASSES if corrected else 1
        counts[OPEN], counts[CUTS] = end < ahead, options.stops == "located"
        rows = active.normal_ids.size + signs.size
        if self._multipliers.size < MOST * rows:
            self._multipliers = np.empty(2 * MOST * rows)
        size = state.size + near.corner.size + rows + stepper.shapes.corner_body.size
        if self._arena.size < size:
            self._arena = Arena.of(2 * size)
        return QuietSteps(
            shapes=stepper.shapes,
            D=stepper.D,
            # constant on the way, but one may begin or end at t itself
            forces=stepper.force(stepper.q, history.v, 0.5 * (stepper.t + until)),
            eps0=asked_accuracy(options.eps, corrected),
            contacts=active.contacts(signs),
            corner=near.corner,
            part=near.part,
            level=near.level,
            free=near.free,
            pairs=near.pairs,
            listed_at=near.listed_at,
            state=state,
            reals=reals,
            counts=counts,
            track=self._track,
            gaps=self._gaps,
            multipliers=self._multipliers[: MOST * rows].reshape(MOST, rows),
            at_bound=np.zeros(signs.size, dtype=np.bool_),
            stopped=np.zeros(signs.size, dtype=np.bool_),
            changes=np.empty((rows, 2), dtype=np.int64),
            sense=np.empty(rows),
            arena=self._arena,
        )


def _follow(stepper: Transitions, run: QuietSteps, active: ActiveSet, taken: int) -> None:
    """Bring the stepper to where the run has come, with what has changed on the way."""
    state, steps = run.state.copy(), int(run.counts[STEPS])
    track, gaps, multipliers = (
        part[:taken].copy() for part in (run.track, run.gaps, run.multipliers)
    )
    m = stepper.q.size
    ids, first = (active.normal_ids, active.friction_ids), 0

    def record(last: int) -> None:
        part = slice(first, last)
        t, q, v = track[part, 0], track[part, 1 : 1 + m], track[part, 1 + m :]
        lam = multipliers[part, : ids[0].size + ids[1].size]
        stepper.stretches.append(Stretch(t, q, v, gaps[part], *ids, lam))

    changes = run.changes[: run.counts[CHANGES]].tolist()
    for (step, row_id), sense in zip(changes, run.sense.tolist(), strict=False):
        if step > first:
            record(step)
            first, stepper.t = step, float(track[step - 1, 0])
        if row_id in stepper.graph.normals:
            stepper.drop(stepper.graph.normals[row_id])  # its level has been kept on the way
        else:
            stepper.slip(stepper.graph.frictions[row_id], int(sense))
        ids = stepper.graph.row_ids()
    if taken > first:
        record(taken)
    N = len(stepper.graph.normals)
    stepper.graph.keep_multipliers((run.contacts.lam[:N], run.contacts.lam_before[:N]))
    stepper.t, h, stepper.h_last = run.reals[[TIME, H, WISH]].tolist()
    stepper.q = state[Q]
    a = [state[A], state[A_BEFORE]][:steps]
    stepper.history.resume(state[V], state[V_BEFORE], a, h, steps)
    stepper.lam_known = int(run.counts[KNOWN])
    stepper.counts["steps"] += taken


def _last_step(stepper: System, run: QuietSteps) -> LastStep:
    assembly, history = Assembly(stepper.graph, stepper.q), stepper.history
    N, F = len(assembly.normals), len(assembly.frictions)
    step = VelocityStep(
        t=stepper.t,
        h=history.h,
        q=stepper.q,
        v=history.v,
        a=history.a[0],
        lam_N=run.contacts.lam[:N],
        lam_F=run.multipliers[run.counts[TAKEN] - 1, N : N + F],
        gap_speed=assembly.gap_speed(history.v),
        slip_speed=assembly.slip_speed(history.v),
        at_bound=run.at_bound[:F],
        assembly=assembly,
        passes=int(run.counts[PASSES]),
    )
    return LastStep(step, run.contacts.signs[:F], run.stopped[:F])
