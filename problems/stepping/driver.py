"""The driver of compiled steps: prepares them, gives what they ask for, follows.

`problems.stepping.steps` takes steps until the stepper is needed.  With a solver that has a
compiled method, whose QPs are not kept, and forces that are constant between their jumps, that is a
stretch of steps at a time.  Else each step asks, one after the other, for its forces, the answer to
each of its QPs and, where there are many contacts, λ_* of its next pass.
"""

from __future__ import annotations

from math import inf
from typing import Any, final

import numpy as np

from problems.bodies.path import Path
from problems.contacts.active_kernels import Frictions
from problems.contacts.assembly import Assembly, scaled_matrix
from problems.contacts.constraint_graph import ActiveSet
from problems.contacts.layout import Layout
from problems.formulas.multistep import asked_accuracy
from problems.friction.passes import ANSWER, FAILED, FORCES, GUESS, Passes
from problems.friction.posed import PosedPasses
from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.qp import Solution, Status, Vector
from problems.qp_kernel import NO_METHOD, WARM
from problems.stepping.drift import closing_motion
from problems.stepping.records import (
    CLOCK,
    FIRST_TRIAL,
    FORCED,
    LOOK_BACK,
    MOST,
    TALLY,
    TRIAL,
    TRY,
    Ends,
    Near,
    Scratch,
    Settings,
    State,
    Steps,
    Stops,
)
from problems.stepping.run import Stretch
from problems.stepping.steps import take_steps
from problems.stepping.system import System
from problems.stepping.velocity import VelocityStep

run_steps = Direct(take_steps)
ASKED = 3000
"""Steps of one call times coordinates where QPs are asked for: after so many it is told how far it
has come."""
NO_CONTACT = Solution(
    x=np.zeros(0),
    row_id=np.zeros(0, dtype=np.int64),
    status=Status.SOLVED,
    working_set=np.zeros(0, dtype=np.int8),
)
"""The answer to the QP of a step in free flight."""
Places = dict[int, tuple[int, int, int]]


@final
class Driver:
    """Takes the steps of a system.

    trial : the next one, `records.TRIAL`;  signs : (F,) s of its frictions, 0 of those that stick
    """

    def __init__(self, system: System) -> None:
        self.system = system
        options, m = system.options, system.q.size
        self._solver: Any = system.qps.solver
        self._always_asks = bool(system.varying) or options.drift != "none"
        self._state = State(*(np.zeros(m) for _ in State._fields))
        self._clock, self._tally, self._trial = (
            np.zeros(1, kind) for kind in (CLOCK, TALLY, TRIAL)
        )
        self._track, self._gaps = np.empty((MOST, 1 + 2 * m)), np.empty(MOST)
        self._multipliers = np.empty(0)
        self._arena = Arena.of(0)
        self._scratch = Scratch.of(system.shapes.edge_offset.shape[1])
        self._settings = Settings(
            *(options.eps, options.drop_tol, options.h_max),
            fixed=options.fixed_step or 0.0,
            rest_speed=options.rest_speed,
            reach=system.graph.candidates.margin / 2,
            allowed=system.allowed_overlap,
            highest=options.order,
            cuts=options.stops == "located",
            corrects=options.friction == "corrected",
            depends=system.velocity_dependent,
            supplied=bool(system.varying) or options.drift == "baumgarte",
            switches=bool(system.switches),
        )
        self._end = 0.0
        self._run: Steps
        self._active: ActiveSet
        self._places: Places | None = None
        self._stops = Stops.of(system.graph.rows.take(system.graph.waiting_stops))
        self._waiting = system.graph.waiting_stops
        self._posed: PosedPasses | None = None

    def begin(self, end: float) -> None:
        """The first trial of the next step, which is not to go beyond `end` [s]."""
        self._end = end
        self._trial[0] = FIRST_TRIAL
        self.prepare()

    @property
    def trial(self) -> np.void:
        """The trial that goes on or has ended."""
        one: np.void = self._trial[0]
        return one

    @property
    def path(self) -> Path:
        """q(h) of the trial."""
        return Path(self.system.q, self.system.history.v, self._run.ends.bend)

    @property
    def signs(self) -> Vector:
        """(F,) s of the frictions in the trial, 0 of those that stick in it."""
        return self._run.contacts.signs

    @property
    def lengths(self) -> Vector:
        """(F,) where on the way friction stops [s], or ∞."""
        return self._run.ends.lengths

    def go_on(self) -> int:
        """Take steps, and follow: why no more are taken, see `problems.stepping.records`."""
        try:
            while True:
                ended = self._call()
                if ended == FORCES:
                    self._give_forces()
                elif ended == ANSWER:
                    self._give_answer()
                elif ended == GUESS:
                    assert self._posed is not None
                    self._posed.guess(self._assembly())
                elif ended == FAILED:  # by the compiled method: the solver may know more ways
                    self._follow()
                    self.trial["asks"] = 1
                    self.prepare(self.signs, self._places)
                else:
                    return ended
        finally:
            self._follow()

    def _call(self) -> int:
        run, system, tally = self._run, self.system, self._tally[0]
        if self.trial["asks"]:
            taken, rejected = int(tally["taken"]), int(tally["rejected"])
            run_steps(run, *NO_METHOD)
            if tally["taken"] > taken or tally["rejected"] > rejected:
                system.qps.settle(accepted=bool(tally["taken"] > taken))
            return int(tally["ended"])
        k = run.passes.x.size
        method = system.qps.compiled(k)
        assert method is not None
        eps0 = asked_accuracy(system.options.eps, self._settings.corrects and self.signs.size > 0)
        room = self._solver.room(system.q.size, k, eps0, system.qps.start())
        mode, now = method.mode | WARM if room.warm else method.mode, run.passes.now[0]
        now["solves"] = 0
        run_steps(run, method.solve, room.S, room.I, room.eps0, mode)
        if now["solves"] or tally["taken"]:
            last = self._solver.last_answer(room) if k else NO_CONTACT
            system.qps.went_on(last, int(tally["solves"]))
        return int(tally["ended"])

    # --- before --------------------------------------------------------------------------------

    def prepare(self, signs: Vector | None = None, places: Places | None = None) -> None:
        """Make ready for the trial.

        signs : (F,) of the frictions in it, else their own
        places : {row_id: (corner, part, edge)} of the constraints that others carry at its end
        """
        system, trial = self.system, self.trial
        graph = system.graph
        active = graph.active_set()
        if places:
            active = active.carried_by(graph.geometry, places)
        own = np.array([friction.sign for friction in active.frictions], dtype=np.float64)
        # one that slides, and sticks in this trial
        watched = signs is not None and bool((own[signs == 0] != 0).any())
        signs = own if signs is None else signs
        layout = active.layout(signs)
        asks = self._always_asks or bool(trial["asks"]) or bool(trial["stuck"])
        asks = asks or system.qps.compiled(layout.k) is None
        trial["asks"], trial["stage"] = asks, LOOK_BACK
        self._set_clock(asks, watched)
        near = graph.candidates
        if not trial["looked"]:
            near.renew(system.q, active.place)
        L = near.corner.size
        passes, ends = self._room(active, layout, signs, asks)
        if not self._settings.supplied:
            # constant on the way, but one may begin or end at t itself
            clock = self._clock[0]
            middle = 0.5 * float(clock["time"] + clock["until"])
            passes.forces[:] = system.force(system.q, system.history.v, middle)
            ends.forces_before[:] = passes.forces
        rows = active.normal_ids.size + signs.size
        if self._multipliers.size < MOST * rows:
            self._multipliers = np.empty(2 * MOST * rows)
        self._active, self._places, self._posed = active, places, None
        self._run = Steps(
            shapes=system.shapes,
            settings=self._settings,
            contacts=active.contacts(signs),
            near=Near(
                *(near.corner, near.part, near.level, near.free, near.pairs, near.listed_at),
                *(np.empty(L), np.empty(L)),
            ),
            state=self._state,
            clock=self._clock,
            tally=self._tally,
            trial=self._trial,
            passes=passes,
            ends=ends,
            track=self._track,
            gaps=self._gaps,
            multipliers=self._multipliers[: MOST * rows].reshape(MOST, rows),
            scratch=self._scratch,
            rows=active.rows,
            stops=self._room_for_stops(),
        )

    def cut(self, h: float, places: Places) -> None:
        """Go on with a step of length h [s], which is known to be met by nothing before its end."""
        self.trial["looked"] = self.trial["cut"] = h
        relisted = self._run.near.corner is not self.system.graph.candidates.corner
        if relisted or places != (self._places or {}):
            self.prepare(self.signs, places)
        else:
            self.trial["stage"] = TRY

    def _set_clock(self, asks: bool, watched: bool) -> None:
        """The state where steps begin, and how far they may go; `watched` as in `TALLY`."""
        system, history, state = self.system, self.system.history, self._state
        state.q[:], state.v[:], state.v_before[:] = system.q, history.v, history.v_before
        for i, array in enumerate((state.a, state.a_before)):
            array[:] = history.a[i] if i < len(history.a) else 0.0
        ahead, end = system.scheduled(), self._end
        most = min(max(1, ASKED // system.q.size), MOST) if asks else MOST
        watched = watched or system.gain_watch.failed or system.options.drift == "projection"
        # in the order of `CLOCK` and `TALLY`
        self._clock[0] = system.t, history.h, system.h_last, min(ahead, end)
        known = history.steps, system.lam_known
        self._tally[0] = (*known, 0, most, 0, 0, end < ahead, watched, 0)

    def _room(
        self, active: ActiveSet, layout: Layout, signs: Vector, asks: bool
    ) -> tuple[Passes, Ends]:
        """What these contacts are stepped with, the same arrays each time."""
        D = self.system.D
        rubs = active.friction_of, active.first, active.mu, signs
        frictions = Frictions(*rubs, *layout.columns)
        size = 2 * D.size + layout.k + self.system.shapes.corner_body.size
        if self._arena.size < size:
            self._arena = Arena.of(2 * size)
        if asks not in layout.room:
            ends = Ends.of(D.size, active.normal_ids.size, signs.size)
            passes = Passes.of(frictions, D, asks, self._arena)
            joined = layout.normal_column[len(active.normals) :]
            passes.lower[joined], passes.upper[joined] = active.rows.lower, active.rows.upper
            layout.room[asks] = passes, ends
        passes, ends = layout.room[asks]
        return passes._replace(frictions=frictions, arena=self._arena), ends

    def _room_for_stops(self) -> Stops:
        """What stops that are not reached are watched with, the same arrays while they are."""
        waiting = self.system.graph.waiting_stops
        if waiting is not self._waiting:
            self._waiting = waiting
            self._stops = Stops.of(self.system.graph.rows.take(waiting))
        return self._stops

    # --- meanwhile -----------------------------------------------------------------------------

    def _assembly(self) -> Assembly:
        """The columns at the end of the trial."""
        return Assembly(self.system.graph, self._run.ends.q.copy(), self._active)

    def _give_forces(self) -> None:
        """f at the guess of q̇ and, at first, where the step begins; what closes gaps."""
        system, run, trial = self.system, self._run, self.trial
        passes, ends, t = run.passes, run.ends, float(trial["t"])
        if trial["stage"] == FORCED:
            self._posed = None
            ends.forces_before[:] = system.force(run.state.q, run.state.v, t)
            if system.drift_time < inf:
                assembly = self._assembly()
                layout = self._active.layout(self.signs)
                A = scaled_matrix(*assembly.laid_out(layout), system.D)
                every = np.arange(assembly.count)
                u = closing_motion(assembly, A, system.D, layout.normal_column, every)
                passes.lean[:] = u / system.drift_time
        passes.forces[:] = system.force(ends.q, passes.guess, t)

    def _give_answer(self) -> None:
        """x and λ of the QP."""
        run, trial, now = self._run, self.trial, self._run.passes.now[0]
        if now["number"] == 1:
            self._posed = PosedPasses(
                *(self.system.qps, run.passes, self._active.layout(self.signs)),
                own=True,
                t=float(trial["t"]),
                h=float(trial["h"]),
                alpha0=float(now["alpha0"]),
            )
        assert self._posed is not None
        again = "iteration" if self._settings.depends else "corrector"
        self._posed.answer("step" if now["number"] == 1 else again)

    # --- after ---------------------------------------------------------------------------------

    def _follow(self) -> None:
        """Bring the system to where the steps have come."""
        system, run, tally, clock = self.system, self._run, self._tally[0], self._clock[0]
        taken, rejected = int(tally["taken"]), int(tally["rejected"])
        tally["taken"] = tally["rejected"] = tally["solves"] = 0
        system.counts["rejected_steps"] += rejected
        if not taken:
            return
        track, m, active = run.track[:taken].copy(), system.q.size, self._active
        system.stretches.append(
            Stretch(
                *(track[:, 0], track[:, 1 : 1 + m], track[:, 1 + m :], run.gaps[:taken].copy()),
                *(active.normal_ids, active.friction_ids, run.multipliers[:taken].copy()),
            )
        )
        q, v, v_before, *a = (part.copy() for part in run.state)
        steps = int(tally["steps"])
        system.q, system.t, system.h_last = q, float(clock["time"]), float(clock["wish"])
        system.history.resume(v, v_before, a[:steps], float(clock["h"]), steps)
        system.lam_known = int(tally["known"])
        system.counts["steps"] += taken
        for friction, sign in zip(active.frictions, run.contacts.signs.tolist(), strict=True):
            if sign != 0:
                friction.sign = int(sign)

    def last_step(self, settled: bool = True) -> VelocityStep:
        """The step or trial that has ended."""
        run, system, trial = self._run, self.system, self.trial
        passes, ends = run.passes, run.ends
        here = settled and self._active is system.graph.active_set()
        assembly = system.assembly() if here else self._assembly()
        return VelocityStep(
            t=float(trial["t"]),
            h=float(trial["h"]),
            q=assembly.q,
            v=passes.v.copy(),
            a=passes.a.copy(),
            lam_N=passes.lam_N.copy(),
            lam_F=passes.lam_F.copy(),
            gap_speed=assembly.gap_speed(passes.v - passes.lean),
            slip_speed=ends.slip_after.copy(),
            at_bound=ends.at_bound.copy(),
            assembly=assembly,
            passes=int(passes.now[0]["number"]),
            settled=settled,
        )
