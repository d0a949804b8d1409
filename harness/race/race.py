"""A race: our methods and packages, each called in the shortest way, one QP right after the other.

A replay (`harness.study.replay`) asks one QP at a time of a process that does other things in
between, as a simulation does, and then caches and branch predictors are cold: whoever needs a
microsecond takes twice that.  Here nothing is in between.  So a race is fairer to the quickest, and
tells less of a program that poses QPs as well; packages share a process, and are trusted.

1. The QPs are those that end a step, in order, with columns, without fixed ones and with a
   reference; the first `MOST` of a recording.  Accuracy asked: 1e-9 of the scale (`high`).
2. A package is called as a careful user would by hand (`harness.race.by_hand`), without an adapter;
   ours by `Solver.solve` from a `ContactQP` that has just been made, and by `solve_arrays`.  Beside
   the race stand our method with that `ContactQP` within (`POSED`), and, where QPs are small, all
   of them in one compiled call (`ONE_CALL`).
3. Rounds: each contestant takes the whole sequence in order, warm from its own last answer, or cold
   and made anew at every QP; and once more, by the clock, so that data and code are where they are
   in a loop.  Then the next one does, in an order that is turned round every time.  The garbage
   collector sleeps meanwhile.
4. Three clocks, read at every QP.  The time of a round is the median over the QPs, that of a
   sequence the median over the rounds.  So is a ratio, of two who took a round within a second or
   so of each other; its interval is the middle half of the rounds.

       inside    by the package's own clock, of ours the compiled call
       arrays    set-up and solve, from what the package takes to x; of ours the call of `solve`
       whole     from A, d and bounds to x, what is taken built within; of ours the call of
                 `solve_arrays`, in a lap of its own; it checks them, and keeps none

   A package's own clock that reads more than ours is not believed, on any QP of the sequence.

5. Every answer of every round is judged (`harness.judging.judge`), after the race.  Who raises has
   none, and begins anew at the next QP; who crashes in a first lap, which is taken in a fork, or
   does not come back from it, has none at all.
"""

from __future__ import annotations

import gc
import os
import time
import warnings
from collections.abc import Sequence
from multiprocessing import get_context
from typing import Any

import numpy as np
import pandas as pd

from harness.judging.facts import facts_of
from harness.judging.judge import judge
from harness.machine.threads import one_thread
from harness.names import METHOD, PAPER
from harness.passes.measure import without_litter
from harness.processes.introduction import available
from harness.race.by_hand import HANDS, Called, Hand, posed_for_hands, takes, timed
from harness.recordings.recording import Recording, Reference
from harness.results.claim import Claim
from problems.qp import ContactQP, Solution, Vector
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.active_set.sequence import SMALL_CALLS, PackedQPs, solve_sequence
from solvers.adapters.quietly import quietly

MOST = 300
"""QPs of a sequence."""
SLOW, LONGEST = 3.0, 30.0
"""[s] A round that takes longer is a contestant's last one; of a lap that takes longer there is no
answer."""
LAPS = 2
"""Of a round, the last of which is timed."""
CLOCKS = ("inside", "arrays", "whole")
ARMS = ("warm", "cold")
OURS = (METHOD, PAPER)
POSED = f"{METHOD}, a ContactQP"
"""Our method from a `ContactQP` that is made within, which copies and checks the arrays."""
ONE_CALL = f"{METHOD}, one call"
"""Our method by `solve_sequence`: from packed arrays, without Python between QPs."""
BESIDE = (POSED, ONE_CALL)
"""What stands beside the race."""
CLOCK = time.perf_counter


def raced_by(names: Sequence[str] = ()) -> list[str]:
    """Who races: those named, or else our methods and all packages that can be called by hand.

    Raises ValueError for a name that is none of these, and ImportError where it is not installed.
    """
    there = available()
    if not names:
        return [*OURS, *BESIDE, *(name for name in HANDS if name in there)]
    for name in names:
        if name not in (*OURS, *BESIDE, *HANDS):
            known = ", ".join((*OURS, *HANDS))
            raise ValueError(f"{name!r} cannot be called by hand; choose from {known}")
        if name in HANDS and name not in there:
            raise ImportError(f"{name} is not installed; see 'glambda solvers {name}'")
    return list(dict.fromkeys(names))


def race_claim(recordings: Sequence[Recording], names: Sequence[str], rounds: int) -> Claim:
    """A unit for each recording and arm, with the rows that `raced` gives.

    Raises ValueError for a recording that holds nothing to race over.
    """
    known: dict[str, list[Entry]] = {}
    units = []
    for recording in recordings:
        known[recording.digest] = entries = entered(recording)
        if not entries:
            raise ValueError(
                f"{recording.scene}: no QP that ends a step has columns, none of them fixed, and a "
                "reference; take another recording"
            )
        here = {"scene": recording.scene, "digest": recording.digest}
        units += [{**here, "arm": arm, "rounds": rounds} for arm in ARMS]

    def rows(scene: str, digest: str, arm: str, **_: Any) -> list[dict[str, Any]]:
        return raced(known[digest], arm, names, rounds)

    solvers = dict.fromkeys(METHOD if name in BESIDE else name for name in names)
    return Claim("race", rows, units, list(solvers))


Entry = tuple[ContactQP, Reference]


def entered(recording: Recording) -> list[Entry]:
    """The QPs of a recording that are raced over, posed to 1e-9 of the scale."""
    found = []
    for qp, reference in zip(recording.qps, recording.references, strict=True):
        known = reference is not None and reference.proof != "ill-posed"
        if known and qp.kind in WARM_KINDS and posed_for_hands(qp):
            assert reference is not None
            found.append((qp.with_accuracy(facts_of(qp).asked("high")), reference))
    return found[:MOST]


def raced(
    entries: Sequence[Entry], arm: str, names: Sequence[str], rounds: int
) -> list[dict[str, Any]]:
    """Rows of the contestants that take these QPs; none where there are none.

    solver;  qps, m, k : number of QPs, and the largest;  round : 0, 1, …
    inside, arrays, whole : [s] medians over the QPs of a round; NaN without a clock
    verified : share of the QPs of which every answer is verified
    error : the largest e of the judge over the scale; inf where there is no x, or none of numbers
    """
    if not entries:
        return []
    qps = [qp for qp, _ in entries]
    racing = [name for name in names if _can_take(name, qps)]
    times = {name: np.full((rounds, len(qps), len(CLOCKS)), np.nan) for name in racing}
    answers: dict[str, list[list[Vector | None]]] = {name: [] for name in racing}
    over: set[str] = set()
    with one_thread(), quietly(), without_litter():
        for name in racing:
            if not _comes_back(name, qps, arm == "warm"):
                over.add(name)
                answers[name] = [[None] * len(qps)] * LAPS
        for number in range(rounds):
            for name in racing[:: -1 if number % 2 else 1]:
                if name in over:
                    continue
                gc.collect()
                began = CLOCK()
                for _ in range(LAPS):
                    times[name][number], found = _lap(name, qps, arm == "warm")
                    answers[name].append(found)
                if CLOCK() - began > SLOW:
                    over.add(name)
    size = {"qps": len(qps), "m": max(qp.m for qp in qps), "k": max(qp.k for qp in qps)}
    rows: list[dict[str, Any]] = []
    for name in racing:
        common = {"solver": name, **size, **_judged(entries, answers[name])}
        taken = times[name][: len(answers[name]) // LAPS]
        for number, medians in enumerate(_medians(taken)):
            rows.append(common | {"round": number} | dict(zip(CLOCKS, medians, strict=True)))
    return rows


def _can_take(name: str, qps: Sequence[ContactQP]) -> bool:
    if name == ONE_CALL:
        return max(qp.k for qp in qps) <= SMALL_CALLS
    return name in (*OURS, POSED) or takes(HANDS[name], qps)


def _comes_back(name: str, qps: Sequence[ContactQP], warm: bool) -> bool:
    """Whether a package ends a lap of its own accord, tried in a fork: some loop for ever."""
    if name not in HANDS or not hasattr(os, "fork"):
        return True
    trial = get_context("fork").Process(target=_lap, args=(name, qps, warm))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork where there are threads
        trial.start()
    try:
        trial.join(LONGEST)
    finally:  # Ctrl-C does not reach who loops in compiled code
        trial.kill()
        trial.join()
    return trial.exitcode == 0


Lap = tuple[Vector, list[Vector | None]]
"""Times (n, 3) by the three clocks [s], and the answers."""


def _lap(name: str, qps: Sequence[ContactQP], warm: bool) -> Lap:
    if name == ONE_CALL:
        return _one_call(qps, warm)
    if name == POSED:
        times, answers = _posed(METHOD, qps, warm)
        return times * [np.nan, np.nan, 1.0], answers  # the others are of METHOD
    return _ours(name, qps, warm) if name in OURS else _by_hand(HANDS[name], qps, warm)


def _ours(name: str, qps: Sequence[ContactQP], warm: bool) -> Lap:
    """A lap of QPs and one of their arrays, which has the last clock; no x where they differ."""
    times, answers = _posed(name, qps, warm)
    solver, last = make_solver(name), None
    for i, (qp, x) in enumerate(zip(qps, answers, strict=True)):
        A, d, lower, upper, row_id = qp.A, qp.d, qp.lower, qp.upper, qp.row_id
        start: Solution | None = last if warm else None
        t, eps0 = qp.t, qp.eps0
        t0 = CLOCK()
        last = solver.solve_arrays(A, d, lower, upper, row_id=row_id, start=start, t=t, eps0=eps0)
        times[i, CLOCKS.index("whole")] = CLOCK() - t0
        if x is None or last.x is None or x.tobytes() != last.x.tobytes():
            answers[i] = None
    return times, answers


def _posed(name: str, qps: Sequence[ContactQP], warm: bool) -> Lap:
    """A lap with a `ContactQP` made for each QP: it has just been built, as what packages take."""
    solver, times, answers = make_solver(name), [], []
    last: Solution | None = None
    for qp in qps:
        A, d, lower, upper, row_id = qp.A, qp.d, qp.lower, qp.upper, qp.row_id
        start = last if warm else None
        t0 = CLOCK()
        posed = ContactQP(A, d, lower, upper, row_id, kind=qp.kind, t=qp.t, eps0=qp.eps0)
        t1 = CLOCK()
        last = solver.solve(posed, start)
        t2 = CLOCK()
        times.append((last.timing.inside, t2 - t1, t2 - t0))
        answers.append(last.x)
    return np.array(times), answers


def _one_call(qps: Sequence[ContactQP], warm: bool) -> Lap:
    packed = PackedQPs.of(qps)
    t0 = CLOCK()
    found = solve_sequence(packed, warm=warm)
    each = (CLOCK() - t0) / len(qps)
    return np.tile([np.nan, each, np.nan], (len(qps), 1)), list(found.x)


def _by_hand(kind: type[Hand], qps: Sequence[ContactQP], warm: bool) -> Lap:
    called, times, answers = Called(kind, warm), [], []
    for qp in qps:
        hand = called.ready_for(qp)
        try:
            build, solve, x = timed(hand, qp)
            times.append((hand.inside(), solve, build + solve))
            answers.append(None if x is None else np.array(x, dtype=np.float64))
        except Exception:  # whatever a package raises: it has no answer, and begins anew
            called.forget()
            times.append((np.nan, np.nan, np.nan))
            answers.append(None)
    return np.array(times), answers


def _medians(times: Vector) -> Vector:
    """Medians over the QPs, (rounds, 3), of times (rounds, n, 3)."""
    if (times[:, :, 0] > times[:, :, 1]).any():
        times[:, :, 0] = np.nan
    return np.median(times, axis=1)


def _judged(
    entries: Sequence[Entry], answers: Sequence[Sequence[Vector | None]]
) -> dict[str, float]:
    """Share verified, and the largest error; the same answer is judged once."""
    verified, worst = 0, 0.0
    for (qp, reference), given in zip(entries, zip(*answers, strict=True), strict=True):
        facts = facts_of(qp)
        different = {None if x is None else x.tobytes(): x for x in given}
        verdicts = [
            judge(qp, x, reference=reference, facts=facts, seek_reference=False)
            for x in different.values()
        ]
        verified += all(each.verdict == "verified" for each in verdicts)
        worst = max(worst, *(each.error / facts.scale for each in verdicts))
    return {"verified": verified / len(entries), "error": worst}


def ratios(rows: pd.DataFrame) -> pd.DataFrame:
    """Our method beside the best package by each clock, least ahead first.

    rows : of `race_claim`

    scene, arm, clock, k;  best : the fastest package by that clock, verified on every QP
    ours, its : [s];  ratio : its time over ours, above 1 where ours is faster
    from, to : the middle half of the ratios of the rounds, `ratio` being their median
    """
    columns = ["scene", "arm", "clock", "k", "best", METHOD, "its", "ratio", "from", "to"]
    found = []
    for (scene, arm), part in rows.groupby(["scene", "arm"], sort=False):
        sound = part[part["verified"] == 1.0]
        for clock in CLOCKS:
            of_rounds = sound.pivot(index="round", columns="solver", values=clock)
            times = of_rounds.median().dropna()
            packages = times[[name for name in times.index if name in HANDS]]
            if METHOD not in times or packages.empty:
                continue
            best = packages.idxmin()
            ratio = of_rounds[best] / of_rounds[METHOD]
            middle = ratio.quantile([0.5, 0.25, 0.75])
            size = part["k"].iloc[0]
            found.append((scene, arm, clock, size, best, times[METHOD], times[best], *middle))
    table = pd.DataFrame(found, columns=columns)
    return table.sort_values("ratio", kind="stable", ignore_index=True)
