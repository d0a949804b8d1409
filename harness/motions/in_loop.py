"""A backend in the loop: what is asked of each QP, what it took, and who is sloppy on purpose.

How accurate an answer a setting asks for, in ‖A δx‖:

    paper      the QP's own ε₀ (3.13);  100x: that many times ε₀
    high       1e-9 of the scale of the QP;  1e-3: that fraction of it
    default    the package's own tolerances

The scale of a QP is known when the QP is: a closed loop computes it (`harness.judging.facts`)
before every solve, outside the time that counts as the solver's.

A sloppy solver answers with x* + δx, ‖A δx‖ being exactly what was asked, so that the effect of
accuracy is seen apart from the habits of any package.  x* is our method's at `EXACT` of
the scale.  The kinds differ in the direction of δx:

    any    random, over all rows: bounds are violated and idle contacts get a force
    free   random, over the rows between their bounds only: the active set is right, as with an
           active-set method that stops its conjugate gradients early
    inside random, over the rows at a bound only, which it moves off it: no contact is ever without
           a force, as with an interior-point method
    more   along x*: contact forces too large, at every QP
    less   along −x*: contact forces too small, at every QP

Without a row to move, δx = 0.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from harness.judging.facts import facts_of, setting_name
from harness.names import METHOD
from harness.processes.introduction import about
from problems.qp import ContactQP, Solution, Vector
from problems.sequence import SolvesQPs
from solvers import make_solver
from solvers.base import Unsupported

EXACT = "1e-12"
"""The setting at which our method counts as exact."""
NOISES = ("any", "free", "inside", "more", "less")
"""Kinds of sloppiness."""
SLOPPY = tuple(f"sloppy[{noise}]" for noise in NOISES)
"""Their names."""
SEED = 1984
ROUNDING = 1e-12
"""A δx whose A δx cancels below this part of |A| |δx| is taken for one of the null space."""

_TINY = 1e-300


def check_setting(setting: str) -> None:
    """Raises ValueError for a text that is no setting."""
    if not setting.endswith("x"):
        setting_name(setting)
        return
    try:
        good = 0 < float(setting[:-1]) < np.inf
    except ValueError:
        good = False
    if not good:
        raise ValueError(f"setting {setting!r}: give a multiple of ε₀ such as 100x")


def posed(setting: str, qp: ContactQP) -> ContactQP:
    """The QP with the accuracy that a setting asks of it; `default` leaves it as it is."""
    if setting in ("paper", "default"):
        return qp
    if setting.endswith("x"):
        return qp.with_accuracy(float(setting[:-1]) * qp.eps0)
    return qp.with_accuracy(facts_of(qp).asked(setting))


def check_backend(name: str, setting: str) -> None:
    """Raises ValueError for an unknown solver or setting, ImportError for an absent package."""
    check_setting(setting)
    if name.startswith("sloppy"):
        if name not in SLOPPY:
            raise ValueError(f"unknown solver {name!r}; sloppy ones are {', '.join(SLOPPY)}")
        if setting == "default":
            raise ValueError(f"{name} has no default; say how sloppy, such as 100x")
    else:
        about(name)


def backend(name: str, setting: str) -> SolvesQPs:
    """The solver of that name, for QPs that carry the accuracy asked."""
    check_setting(setting)
    if name.startswith("sloppy"):
        return Sloppy(name[len("sloppy[") : -1])
    return make_solver(name, accuracy="default") if setting == "default" else make_solver(name)


class OutOfTime(RuntimeError):
    """The time limit of a run was reached."""


class InLoop:
    """A solver at a setting as a simulation drives it, with what it cost so far.

    calls : solves, with those that were asked for again cold
    call_time : [s] in `solve`;  solve_time : [s] of it setup and solve, by the solver's own clocks
    deadline : `time.perf_counter` beyond which the next call raises `OutOfTime`
    refused : why the last QP was not taken, if it was not;  out_of_time : whether that was why
    """

    def __init__(self, name: str, setting: str, time_limit: float = float("inf")) -> None:
        self.solver, self.setting = backend(name, setting), setting
        self.deadline = time.perf_counter() + time_limit
        self.calls, self.call_time, self.solve_time = 0, 0.0, 0.0
        self.refused, self.out_of_time = "", False

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """The solver's answer at the accuracy of the setting."""
        qp = posed(self.setting, qp)
        before = time.perf_counter()
        if before > self.deadline:
            self.out_of_time = True
            raise OutOfTime("the time limit of the run was reached")
        try:
            solution = self.solver.solve(qp, start)
        except Unsupported as reason:
            self.refused = str(reason)
            raise
        self.call_time += time.perf_counter() - before
        self.solve_time += solution.timing.setup + solution.timing.solve
        self.calls += 1
        return solution


def exact(qp: ContactQP) -> Vector:
    """x* (k,) by our method at `EXACT` of the scale.

    Raises ValueError where it gives no answer.
    """
    solution = make_solver(METHOD).solve(posed(EXACT, qp))
    if solution.x is None:
        raise ValueError(f"no answer to a {qp.kind} QP at t = {qp.t:.6g} to compare with")
    return solution.x


@dataclass
class Sloppy:
    """Answers x* + δx with ‖A δx‖ = the QP's eps0; see the module for the kinds of noise."""

    noise: str
    seed: int = SEED

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """The spoilt answer; a start is not used."""
        solution = make_solver(METHOD).solve(posed(EXACT, qp))
        if solution.x is None or qp.k == 0:
            return solution
        x = solution.x + qp.eps0 * self.direction(qp, solution.x)
        return replace(solution, x=x, memory=None)

    def direction(self, qp: ContactQP, x: Vector) -> Vector:
        """δx (k,) with ‖A δx‖ = 1, or 0 where no row can be moved."""
        if self.noise in ("more", "less"):
            move = x if self.noise == "more" else -x
        else:
            lengths = np.linalg.norm(qp.dense_A, axis=0)
            move = self._random.standard_normal(qp.k) / np.maximum(lengths, _TINY)
            low, high = x <= qp.lower, x >= qp.upper
            if self.noise == "free":
                move = np.where(low | high, 0.0, move)
            elif self.noise == "inside":
                move = np.abs(move) * np.where(low, 1.0, np.where(high, -1.0, 0.0))
        move = np.where(qp.lower < qp.upper, move, 0.0)
        size = float(np.linalg.norm(qp.A @ move))
        spent = float(np.linalg.norm(abs(qp.A) @ np.abs(move)))
        return move / size if size > ROUNDING * spent else np.zeros(qp.k)
