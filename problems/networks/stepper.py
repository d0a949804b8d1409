"""Algorithm 1 for networks: BDF-r, a QP at every step, restarts where di/dt jumps.

One step from t_{n−1} to t_n:

    1. h by (3.5), at most `Network.h_max`, and never across a jump of a source or a switch
    2. i_n, q_n and the multipliers by the QP (`problems.networks.step`)
    3. where a diode that conducted would block on the way, di/dt jumps there: the earliest such
       time t_* is located, the step is redone to end there, and the integration restarts with two
       first-order steps, as it does at a jump of a source or a switch
    4. a diode that begins to conduct does not restart: di/dt is continuous

(3.5) is the paper's, with charges for positions and the norm of the inductances for ‖·‖_M: branches
without inductance have no inertia and do not enter.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, final

import numpy as np
import scipy
from numpy.typing import NDArray

from problems.formulas.multistep import (
    REDONE,
    SHORTEST_STEP,
    first_order_step,
    first_redone_length,
    next_length,
    redone_length,
    second_order_error,
    second_order_step,
)
from problems.networks.network import Network
from problems.networks.run import NetworkRun
from problems.networks.step import NetworkQPs, NetworkStep, Past, State
from problems.qp import Vector
from problems.sequence import QPSequence, SolvesQPs
from problems.stepping.options import StepperOptions, end_of
from problems.stepping.run import Event, kept_until_then

Mask = NDArray[np.bool_]
FIRST_ORDER = 2
"""Steps of order 1 after a restart (§3.1)."""
USED = ("eps", "fixed_step", "h_first", "h_max", "order")
"""Options that a network is stepped with; the others are about contacts."""


def simulate(
    network: Network,
    solver: SolvesQPs,
    *,
    eps: float | None = None,
    until: float | None = None,
    keep_qps: bool = True,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> NetworkRun:
    """Simulate a network with `solver` in the loop, as `problems.simulate` does bodies.

    settings : of `StepperOptions`, those of `USED`

    Raises ValueError for bad settings and for those that are about contacts, `SimulationError`
    where the simulation cannot go on.  Whatever ends it early has the motion until then as its
    `run`.
    """
    options = StepperOptions.of(network.eps if eps is None else eps, **settings)
    options.refuse_all_but(USED, "is about contacts of bodies, and a network has none")
    end = end_of(network.end_time, until)
    stepper = NetworkStepper(network, solver, options, end, keep_qps)
    with kept_until_then(stepper.kept, stepper.finish):
        while stepper.t < end:
            stepper.advance()
            if progress is not None:
                progress(stepper.t)
    return stepper.finish()


@final
class NetworkStepper:
    """One simulation; `advance` until t has reached the end, then `finish`.

    past, steps : see `Past`; steps since the last restart
    wish : the length that the last step was to have [s];  allowed : by (3.5), for the next
    conducts : (b,) which diodes let a current through
    """

    def __init__(
        self,
        network: Network,
        solver: SolvesQPs,
        options: StepperOptions,
        end: float,
        keep_qps: bool = True,
    ):
        self.network, self.options = network, options
        self.qps = QPSequence(solver, keep_qps)
        self.posed = NetworkQPs(network, self.qps, options.eps)
        self.times = [*network.jumps(end), end]
        start = network.start()
        self.t, self.past, self.steps = 0.0, Past(start, start, 0.0), 0
        self.wish, self.allowed = options.h_first, np.inf
        self.h_max = min(options.h_max, network.h_max)
        self.conducts = self.posed.has_diode & (start.i > 0)
        self.counts = dict.fromkeys(("steps", "rejected_steps", "restarts"), 0)
        self.event_log: list[Event] = []
        unknown = np.full(self.posed.n, np.nan), np.full(start.i.size, np.nan)
        self.kept = [(0.0, start.i, start.q, *unknown)]

    def advance(self) -> None:
        """One accepted step."""
        ahead = self.times[bisect_right(self.times, self.t)]
        self.wish = self._wanted()
        step = self._accurate(min(self.wish, ahead - self.t), ahead)
        blocked = self.conducts & (step.free < 0)
        if blocked.any():
            step, blocked = self._located(step, blocked, ahead)
        self._accept(step)
        if blocked.any():
            self.conducts &= ~blocked
            self._log("blocks", blocked)
            self._restart()
        elif step.t == ahead and ahead != self.times[-1]:
            self._log("switch")
            self._restart()

    def _wanted(self) -> float:
        """Step 1: what (3.5) allows after the last step [s]."""
        if self.options.fixed_step is not None:
            return min(self.options.fixed_step, self.h_max)
        return next_length(self.wish, self.steps, self.allowed, self.h_max)

    def _trial(self, h: float, ahead: float) -> NetworkStep:
        """The step of length h, or to `ahead` exactly where it is as good as there."""
        self.counts["rejected_steps"] += 1  # those that are taken are subtracted
        self.qps.settle(accepted=False)
        if abs(self.t + h - ahead) < SHORTEST_STEP:
            return self.posed.step(ahead, ahead - self.t, self.past)
        return self.posed.step(self.t + h, h, self.past)

    def _accurate(self, h: float, ahead: float) -> NetworkStep:
        """Step 2, redone where the error turns out too large."""
        step = self._trial(h, ahead)
        for _ in range(REDONE):
            shorter = self._redone(step)
            if not shorter < step.h:
                break
            self.wish = max(shorter, 10 * SHORTEST_STEP)
            step = self._trial(min(self.wish, ahead - self.t), ahead)
        return step

    def _redone(self, step: NetworkStep) -> float:
        """A shorter h where (3.5) does not hold after all, else ∞."""
        if self.options.fixed_step is not None:
            return np.inf
        eps = self.options.eps
        if self.steps == 0:
            return first_redone_length(step.h, first_order_step(self._norm(step.state.a), eps))
        if self.past.h == 0:
            return np.inf
        change = self._norm(step.state.a - self.past.last.a)
        return redone_length(step.h, second_order_error(change, step.h, self.past.h), eps)

    def _located(self, step: NetworkStep, blocked: Mask, ahead: float) -> tuple[NetworkStep, Mask]:
        """Step 3: the step that ends where the first diodes block, and which do.

        Those that block at t_{n−1} itself, since a switch has closed there, cut no step.
        """
        shortest = min(SHORTEST_STEP, step.h / 2)
        later = blocked & (self._trial(shortest, ahead).free > 0)
        last = step

        def least(h: float) -> float:
            nonlocal last
            last = self._trial(h, ahead)
            return float(last.free[later].min())

        self.conducts &= later | ~blocked
        if not later.any():
            return self._trial(step.h, ahead), later
        least(float(scipy.optimize.brentq(least, shortest, step.h, xtol=SHORTEST_STEP)))
        speed = np.abs(last.free - self.past.last.i) / last.h
        return last, later & (last.free <= last.free[later].min() + 10 * SHORTEST_STEP * speed)

    def _accept(self, step: NetworkStep) -> None:
        self.qps.settle(accepted=True)
        last = self.past.last
        self.t, self.steps = step.t, self.steps + 1
        self.counts["steps"] += 1
        self.allowed = self._allowed(step, last)
        second = self.options.order == 2 and self.steps >= FIRST_ORDER
        self.past = Past(step.state, last, step.h if second else 0.0)
        now = self.posed.has_diode & (step.free > 0)
        self._log("conducts", now & ~self.conducts)
        self.conducts = now
        self.kept.append((step.t, *step.state[:2], step.potentials, step.diodes))

    def _allowed(self, step: NetworkStep, last: State) -> float:
        """The step that (3.5) allows next [s]."""
        eps = self.options.eps
        if self.options.order == 1 or self.steps < FIRST_ORDER:
            return first_order_step(self._norm(step.state.a), eps)
        return second_order_step(self._norm(step.state.a - last.a) / step.h, step.h, eps)

    def _norm(self, a: Vector) -> float:
        """‖·‖ of the inductances."""
        return float(np.sqrt(self.posed.L @ (a * a)))

    def _restart(self) -> None:
        self.past, self.steps = Past(self.past.last, self.past.last, 0.0), 0
        self.counts["restarts"] += 1
        self.qps.restart()

    def _log(self, kind: str, which: Mask | None = None) -> None:
        """One event, or one for each branch of `which`."""
        names = self.network.names()
        details = [""] if which is None else [names[j] for j in np.flatnonzero(which)]
        self.event_log += [Event(self.t, kind, detail) for detail in details]

    def finish(self) -> NetworkRun:
        """Everything that the simulation leaves behind."""
        t, currents, charges, potentials, diodes = (
            np.array(column) for column in zip(*self.kept, strict=True)
        )
        counts = self.counts | {"qps": self.qps.count}
        counts["rejected_steps"] -= counts["steps"]
        return NetworkRun(
            self.network,
            t,
            currents,
            charges,
            potentials,
            diodes,
            event_log=self.event_log,
            qps=self.qps.qps,
            solutions=self.qps.solutions,
            counts=counts,
            options=asdict(self.options),
        )
