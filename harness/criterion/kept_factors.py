"""What off-the-shelf packages gain by keeping what they made for an earlier QP.

OSQP, ProxQP and PIQP hold an object that can be updated along a sequence.  None of them can use a
factorization of an earlier matrix as a preconditioner, as the paper's method does; what they can
keep, and renew every s QPs, is

    osqp     setup           the object: its scaling and the symbolic factorization (and ρ)
             ρ               the step size ρ that has adapted itself; renewed: back to 0.1
             P               the matrix with its factorization; only q and the bounds are today's
    proxqp   setup           the object, with the preconditioner (a scaling) made for its first QP
             preconditioner  that scaling alone
    piqp     setup           the object, with the symbolic factorization
             scaling         the equilibration of the matrix

Everything else is as in the adapters: x and multipliers are carried from QP to QP, the data are
today's.  "osqp, P" is the exception: with an old P another QP is solved, and only the error of A x
tells whether that mattered.  Where rows come or go, everything is set up anew under every interval.

Each sequence is that of `harness.criterion.factor_rules`, its first `LONGEST` QPs, at setting
`paper`.  The cost of a QP is the package's own, setup and solve, the least of some runs that are
taken in turn. The mean is reported and not the median, because one QP in s carries the renewal.  An
answer is verified when ‖A δx‖ against the recorded reference is at most `VERIFIED_WITHIN` times the
accuracy asked.  Our method stands beside the packages, as it is shipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from harness.criterion.factor_rules import Link, sequence
from harness.judging.judge import VERIFIED_WITHIN
from harness.machine.threads import one_thread
from harness.names import METHOD
from harness.recordings.recording import Recording
from problems.qp import Solution
from solvers import describe, make_solver
from solvers.adapters.package import Built, Native, PackageSolver, same_pattern
from solvers.base import Solver, Start

INTERVALS = (1, 2, 5, 10, 20, inf)
"""QPs from one renewal to the next."""
LONGEST = 120
"""QPs of a sequence that are used."""
LIMIT = 2.0
"""[s] A run that takes longer ends there, and is not repeated."""
FIRST_RHO = 0.1
"""OSQP's default for ρ."""

COLUMNS = (
    *("scene", "package", "kept", "interval", "QPs", "mean", "median", "iterations"),
    *("renewals", "verified", "worst"),
)


class Hooks(NamedTuple):
    """What is done beside what an adapter does: before its setup, and after it (timed)."""

    before: Callable[[Built], Built] = lambda built: built
    after: Callable[[Native, Built], Native] = lambda native, built: native


class Kind(NamedTuple):
    """Something that a package can keep: how to keep it and how to renew it."""

    package: str
    kept: str
    keep: Hooks
    renew: Hooks


class Plan(NamedTuple):
    """A kind at one interval."""

    package: str
    kept: str
    interval: float
    keep: Solver
    renew: Solver


def afresh(built: Built) -> Built:
    """No object is updated; x and the multipliers are still carried over."""
    return built._replace(carried=None)


def first_rho(native: Native, built: Built) -> Native:
    """OSQP's ρ as it was before it adapted itself."""
    native.object.update_settings(rho=FIRST_RHO)
    return native


def old_P(built: Built) -> Built:
    """OSQP: the matrix of the previous solve instead of today's."""
    if built.carried is None:
        return built
    old = built.carried.native.arrays[0]
    if not same_pattern(old, built.arrays[0]):
        return built
    return built._replace(arrays=(old, *built.arrays[1:]))


def new_preconditioner(built: Built) -> Built:
    """ProxQP: the last argument of `init` and `update`, true for both."""
    return built._replace(arrays=(*built.arrays, True))


def scaling(reused: bool) -> Callable[[Built], Built]:
    """PIQP: whether an update keeps the equilibration."""

    def before(built: Built) -> Built:
        if built.carried is not None:
            settings = built.carried.native.object.settings
            settings.preconditioner_reuse_on_update = reused
        return built

    return before


KINDS = (
    Kind("osqp", "setup", Hooks(), Hooks(before=afresh)),
    Kind("osqp", "ρ", Hooks(), Hooks(after=first_rho)),
    Kind("osqp", "P", Hooks(before=old_P), Hooks()),
    Kind("proxqp", "setup", Hooks(), Hooks(before=afresh)),
    Kind("proxqp", "preconditioner", Hooks(), Hooks(before=new_preconditioner)),
    Kind("piqp", "setup", Hooks(), Hooks(before=afresh)),
    Kind("piqp", "scaling", Hooks(before=scaling(True)), Hooks(before=scaling(False))),
)


def kept_factors(
    recording: Recording, *, turns: int = 3, kinds: Sequence[Kind] = KINDS
) -> pd.DataFrame:
    """Every kind at every interval, one row each, and one of our method.

    Packages that are not installed are left out; no rows where no QP starts warm.  Columns: scene,
    package, kept, interval, QPs (with a predecessor, within `LIMIT`), mean and median [s],
    iterations (mean), renewals (share of the QPs), verified (share of those with a reference) and
    worst, the largest error in units of ε₀ (inf where the package gave no x).
    """
    plans = list(_plans([kind for kind in kinds if describe(kind.package).available]))
    links = [link for link in sequence(recording) if link.qp.k][:LONGEST]
    runs: dict[Plan, pd.DataFrame] = {}
    if any(link.warm for link in links):
        with one_thread():
            for _ in range(turns):
                for plan in plans:
                    _fastest(runs, plan, recording, links)
    rows = [_row(recording.scene, plan, run) for plan, run in runs.items()]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _plans(kinds: Sequence[Kind]) -> Iterator[Plan]:
    for kind in kinds:
        keep, renew = (hooked(kind.package, hooks) for hooks in (kind.keep, kind.renew))
        for interval in INTERVALS:
            yield Plan(kind.package, kind.kept, interval, keep, renew)
    alone = make_solver(METHOD)
    yield Plan(METHOD, "as shipped", inf, alone, alone)


def hooked(package: str, hooks: Hooks) -> Solver:
    """The package's solver with hooks."""
    solver = make_solver(package)
    assert isinstance(solver, PackageSolver)
    adapter: Any = type(solver)

    class Hooked(adapter):
        def build(self, qp: Any, start: Start | None) -> Built:
            return hooks.before(super().build(qp, start))

        def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
            return hooks.after(super().setup(problem, asked, start), problem)

    made: Solver = Hooked()
    return made


def _fastest(
    runs: dict[Plan, pd.DataFrame], plan: Plan, recording: Recording, links: Sequence[Link]
) -> None:
    """Run once more, unless that takes long, and keep the least time of each QP."""
    if plan not in runs:
        runs[plan] = follow(recording, links, plan.keep, plan.renew, plan.interval)
    elif runs[plan]["runtime"].sum() < LIMIT:
        again = follow(recording, links, plan.keep, plan.renew, plan.interval)
        runs[plan]["runtime"] = np.fmin(runs[plan]["runtime"], again["runtime"])


def _row(scene: str, plan: Plan, run: pd.DataFrame) -> dict[str, Any]:
    warm = run[run["warm"]]
    known = warm["error"].notna()
    return {
        "scene": scene,
        "package": plan.package,
        "kept": plan.kept,
        "interval": plan.interval,
        "QPs": len(warm),
        "mean": warm["runtime"].mean(),
        "median": warm["runtime"].median(),
        "iterations": warm["iterations"].mean(),
        "renewals": warm["renewed"].mean(),
        "verified": (warm.loc[known, "error"] <= VERIFIED_WITHIN).mean() if known.any() else nan,
        "worst": warm["error"].max(),
    }


def follow(
    recording: Recording, links: Sequence[Link], keep: Solver, renew: Solver, interval: float
) -> pd.DataFrame:
    """Solve the sequence, renewing every `interval` QPs; one row per QP within `LIMIT`.

    Columns: warm, renewed, runtime (setup and solve) [s], iterations and error, ‖A δx‖/ε₀ (inf
    without an x, NaN without a reference).
    """
    last: Solution | None = None
    age, spent = 0, 0.0
    rows = []
    for link in links:
        if spent >= LIMIT:
            break
        start = last if link.warm else None
        age += 1
        renewed = start is None or age >= interval
        if renewed:
            age = 0
        last = (renew if renewed else keep).solve(link.qp, start)
        runtime = last.timing.setup + last.timing.solve
        spent += runtime
        error = _error(recording, link, last)
        rows.append((link.warm, renewed, runtime, last.iterations, error))
    columns = ["warm", "renewed", "runtime", "iterations", "error"]
    return pd.DataFrame(rows, columns=columns).astype({"warm": bool, "renewed": bool})


def _error(recording: Recording, link: Link, solution: Solution) -> float:
    known = recording.references[link.place]
    if known is None:
        return nan
    if solution.x is None:
        return inf
    return float(np.linalg.norm(link.qp.A @ solution.x - known.Ax)) / link.qp.eps0
