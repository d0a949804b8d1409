"""Quiet steps of a run whose QPs are not kept: taken in compiled code, many at a time.

Between events a step is always the same: AB-r, columns, passes of QPs, BDF-r, the length of the
next.  `problems.stepping.quiet_steps` is a loop over such steps, with the QP method that the solver
hands over (`problems.qp_kernel`); it ends where the stepper is needed: at a collision, at an end of
an edge, after a step with which friction stops.  What it does is what `Stepper.advance` does, up to
rounding, and with more columns than the solver has a path of its own for, up to the accuracy asked
of QPs.  Forces must be constant between their jumps.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from problems.contacts.constraint_graph import ActiveSet
from problems.formulas.multistep import asked_accuracy
from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.qp import Solution, Status, Vector
from problems.qp_kernel import WARM
from problems.stepping.quiet_records import (
    AGAIN,
    CLOCK,
    EVENT,
    LOOK,
    MOST,
    TALLY,
    QuietSteps,
    Settings,
    State,
)
from problems.stepping.quiet_steps import quiet_steps
from problems.stepping.run import Stretch
from problems.stepping.system import System
from problems.stepping.transitions import Transitions
from problems.stepping.velocity import MAX_PASSES, VelocityStep

run_quiet_steps = Direct(quiet_steps)
NO_CONTACT = Solution(
    x=np.zeros(0),
    row_id=np.zeros(0, dtype=np.int64),
    status=Status.SOLVED,
    working_set=np.zeros(0, dtype=np.int8),
)
"""The answer to the QP of a step in free flight."""


class LastStep(NamedTuple):
    """A step that the stepper has to look at, s (F,) of its frictions, and whether they stop."""

    step: VelocityStep
    signs: Vector
    stopped: NDArray[np.bool_]


@final
class Quiet:
    """Takes the quiet steps of a system, where they can be compiled and there may be any."""

    def __init__(self, system: System, transitions: Transitions) -> None:
        self.system, self.transitions = system, transitions
        self.solver: Any = system.qps.solver
        able = system.qps.compiled(0) is not None
        self.able = able and system.options.drift == "none" and not system.varying
        self._event_is_next = False
        if not self.able:
            return
        m, options = system.q.size, system.options
        self._state = State(*(np.zeros(m) for _ in State._fields))
        self._clock, self._tally = np.zeros(1, CLOCK), np.zeros(1, TALLY)
        self._track, self._gaps = np.empty((MOST, 1 + 2 * m)), np.empty(MOST)
        self._multipliers = np.empty(0)
        self._arena = Arena.of(0)
        self._settings = Settings(
            *(options.eps, options.drop_tol, options.h_max),
            fixed=options.fixed_step or 0.0,
            rest_speed=options.rest_speed,
            reach=system.graph.candidates.margin / 2,
            allowed=system.allowed_overlap,
            highest=options.order,
            cuts=options.stops == "located",
        )

    def take_steps(self, end: float) -> tuple[int, LastStep | None]:
        """Take steps from here to `end` [s]: how many, and the last of them.

        The system is left as it is after that; before step 4, where the last step is given.
        """
        system = self.system
        if not (self.able and self._may_take_any()):
            return 0, None
        taken, ended = 0, AGAIN
        while ended == AGAIN:
            active = system.graph.active_set()
            k = active.normal_ids.size + active.friction_ids.size
            method = system.qps.compiled(k)
            if method is None:
                ended = EVENT
                break
            run = self._prepare(active, end)
            room = self.solver.room(system.q.size, k, run.eps0, system.qps.start())
            mode = method.mode | WARM if room.warm else method.mode
            run_quiet_steps(run, method.solve, room.S, room.I, room.eps0, mode)
            tally = run.tally[0]
            steps, ended, solves = (int(tally[name]) for name in ("taken", "ended", "solves"))
            if steps or solves:
                last = self.solver.last_answer(room) if solves else NO_CONTACT
                system.qps.went_on(last, int(tally["counted"]))
                system.counts["rejected_steps"] += int(tally["rejected"])
            if steps:
                self._follow(run, active, steps)
                system.watch_progress()
            taken += steps
        self._event_is_next = taken > 0 and ended != LOOK
        return taken, _last_step(system, run) if ended == LOOK else None

    def _may_take_any(self) -> bool:
        system = self.system
        event, self._event_is_next = self._event_is_next, False
        if event or system.gain_watch.failed:
            return False
        # (4.4) is computed by the stepper where it is no mere guess
        guessed = system.options.friction == "corrected" or not system.graph.frictions
        return system.lam_known > 0 or guessed

    def _prepare(self, active: ActiveSet, end: float) -> QuietSteps:
        system = self.system
        graph, history, options = system.graph, system.history, system.options
        ahead = system.scheduled()
        until = min(ahead, end)
        near = graph.candidates
        near.renew(system.q, active.place)
        state, clock, tally = self._state, self._clock[0], self._tally[0]
        state.q[:], state.v[:], state.v_before[:] = system.q, history.v, history.v_before
        for array, a in zip((state.a, state.a_before), history.a, strict=False):
            array[:] = a
        clock["time"], clock["h"], clock["wish"] = system.t, history.h, system.h_last
        clock["until"] = until
        signs = np.array([friction.sign for friction in active.frictions], dtype=np.float64)
        corrected = options.friction == "corrected" and signs.size > 0
        self._tally[:] = 0
        tally["steps"], tally["known"] = history.steps, system.lam_known
        tally["most_passes"] = MAX_PASSES if corrected else 1
        tally["is_open"] = end < ahead
        rows = active.normal_ids.size + signs.size
        if self._multipliers.size < MOST * rows:
            self._multipliers = np.empty(2 * MOST * rows)
        size = 5 * system.q.size + near.corner.size + rows + system.shapes.corner_body.size
        if self._arena.size < size:
            self._arena = Arena.of(2 * size)
        return QuietSteps(
            shapes=system.shapes,
            D=system.D,
            # constant on the way, but one may begin or end at t itself
            forces=system.force(system.q, history.v, 0.5 * (system.t + until)),
            eps0=asked_accuracy(options.eps, corrected),
            contacts=active.contacts(signs),
            corner=near.corner,
            part=near.part,
            level=near.level,
            free=near.free,
            pairs=near.pairs,
            listed_at=near.listed_at,
            state=state,
            settings=self._settings,
            clock=self._clock,
            tally=self._tally,
            track=self._track,
            gaps=self._gaps,
            multipliers=self._multipliers[: MOST * rows].reshape(MOST, rows),
            at_bound=np.zeros(signs.size, dtype=np.bool_),
            stopped=np.zeros(signs.size, dtype=np.bool_),
            changes=np.empty((rows, 2), dtype=np.int64),
            sense=np.empty(rows),
            arena=self._arena,
        )

    def _follow(self, run: QuietSteps, active: ActiveSet, taken: int) -> None:
        """Bring the system to where the run has come, with what has changed on the way."""
        system = self.system
        state, clock, tally = (part.copy() for part in run.state), run.clock[0], run.tally[0]
        q, v, v_before, *a = state
        track, gaps, multipliers = (
            part[:taken].copy() for part in (run.track, run.gaps, run.multipliers)
        )
        m = system.q.size
        ids, first = (active.normal_ids, active.friction_ids), 0

        def record(last: int) -> None:
            part = slice(first, last)
            t, q, v = track[part, 0], track[part, 1 : 1 + m], track[part, 1 + m :]
            lam = multipliers[part, : ids[0].size + ids[1].size]
            system.stretches.append(Stretch(t, q, v, gaps[part], *ids, lam))

        changes = run.changes[: tally["changes"]].tolist()
        for (step, row_id), sense in zip(changes, run.sense.tolist(), strict=False):
            if step > first:
                record(step)
                first, system.t = step, float(track[step - 1, 0])
            if row_id in system.graph.normals:
                self.transitions.drop(
                    system.graph.normals[row_id]
                )  # its level has been kept on the way
            else:
                self.transitions.slip(system.graph.frictions[row_id], int(sense))
            ids = system.graph.row_ids()
        if taken > first:
            record(taken)
        N = len(system.graph.normals)
        system.graph.keep_multipliers((run.contacts.lam[:N], run.contacts.lam_before[:N]))
        system.t, system.h_last = float(clock["time"]), float(clock["wish"])
        system.q = q
        steps = int(tally["steps"])
        system.history.resume(v, v_before, a[:steps], float(clock["h"]), steps)
        system.lam_known = int(tally["known"])
        system.counts["steps"] += taken


def _last_step(system: System, run: QuietSteps) -> LastStep:
    assembly, history = system.assembly(), system.history
    N, F = len(assembly.normals), len(assembly.frictions)
    step = VelocityStep(
        t=system.t,
        h=history.h,
        q=system.q,
        v=history.v,
        a=history.a[0],
        lam_N=run.contacts.lam[:N],
        lam_F=run.multipliers[run.tally[0]["taken"] - 1, N : N + F],
        gap_speed=assembly.gap_speed(history.v),
        slip_speed=assembly.slip_speed(history.v),
        at_bound=run.at_bound[:F],
        assembly=assembly,
        passes=int(run.tally[0]["passes"]),
    )
    return LastStep(step, run.contacts.signs[:F], run.stopped[:F])
