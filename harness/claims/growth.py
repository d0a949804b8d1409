"""How the time per QP grows with the number of columns k, backend by backend.

For each family of scenes and each number of bodies, smallest first:

1. A short motion is recorded, `STEPS` steps of `STEP` seconds without error control, so that all
   sizes are asked the same, and no more than the first `MOST` of its QPs, of which friction poses
   hundreds; of large ones fewer (`is_enough`).  A is stored sparse unless it is small or full, for
   every package that takes sparse matrices is faster with it, and with a pattern that keeps
   (`whole_bodies`).
2. It is replayed at accuracy `high` through the backends (`harness.study.replay`: interleaved
   passes, answers judged, the least time of each QP counts), each warm, or cold where it has no way
   of keeping anything from one QP to the next.
3. A backend whose median call exceeds the limit, or by its growth would exceed `FAR` limits at the
   next size, or fewer than half of whose answers are verified, is not tried there; the reason is
   kept.  A QP of a minimum norm may be ill-posed, with columns opposite but for rounding: where of
   nobody's answer anything is proved, it counts in the times, and not in the share verified.

The folder holds recordings and results.  What is finished in it is not done again; it belongs to
one version of the code, and refuses another's (`harness.results.store`).

The exponent p in time ~ k^p is fitted by least squares to the logarithms, over the sizes of
`FIT_FROM` columns and more: below, what is spent on every call, whatever its size, hides it.  Its
range is that of the slopes between neighbouring sizes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import log
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.sparse as sp

from harness.processes.introduction import about, available
from harness.progress import Progress
from harness.recordings.recording import Recording
from harness.results.store import read_repeats
from harness.study.kept_recording import how_run, recording_in
from harness.study.record import recording_of
from harness.study.replay import replay
from problems import ContactQP, Run, Solution, simulate
from problems import scene as make_scene
from problems.qp import Matrix
from problems.scenes.calm import calm_scene
from problems.scenes.labels import parse_label
from problems.sequence import SolvesQPs
from solvers import make_solver
from solvers.active_set.method import is_small_or_full

FAMILIES = ("tower", "wall")
BODIES = (5, 10, 20, 50, 110, 225, 500, 1000, 2000, 5000)
MORE_BODIES = {"tower": (10_000,), "heap": (10_000,)}
"""Sizes beyond `BODIES` of a family that has few columns per body."""
SOLVERS = (
    *("glambda", "clarabel", "daqp", "highs", "osqp", "piqp", "proxqp"),
    *("quadprog", "scipy_bvls", "scs", "pgs"),
)
"""Who is tried where nobody is named, if it is installed."""
STEPS, STEP = 8, 0.005
"""Steps of a sequence, and their length [s]."""
MOST, LEAST, COLUMNS = 60, 8, 60_000
"""QPs of a sequence; and of those past the first `LEAST`, as many as have so many columns."""
COORDINATES = 3
"""Rows of A that belong together: of a body, in space of its motion or its rotation."""
FAR = 4.0
"""Limits that a call is expected to take where a size is not even tried."""
LIMIT = 2.0
"""Median of a whole call [s] beyond which a backend is not tried at the next size."""
STEEPEST = 4.0
"""Power of k by which a time is taken to grow at most: between sizes near each other, of which one
has QPs of another kind, it would be any."""
HALF = 0.5
DECIDED = ["verified", "inaccurate", "claimed_wrong"]
"""Verdicts of answers of which something is proved."""
TIMEOUT = 10.0
"""Limits that an answer may take; one that takes longer is not judged."""
SLOW_PASS = 3.0
"""[s] A pass that takes longer is not repeated."""
FIT_FROM = 100
"""Columns from which on the exponent is fitted."""


class Exponent(NamedTuple):
    """p in time ~ k^p over the sizes k_from … k_to; low and high of the neighbouring slopes."""

    p: float
    low: float
    high: float
    k_from: int
    k_to: int


@dataclass(frozen=True)
class Plan:
    """What is measured.

    families : labels of scenes, such as "tower" or "wall,mu=0.3"
    bodies : sizes; empty: `BODIES`, and `MORE_BODIES` of the family
    solvers : names; empty: those of `SOLVERS` that are installed
    limit : [s] median call beyond which a solver is not tried at the next size
    """

    families: tuple[str, ...] = FAMILIES
    bodies: tuple[int, ...] = ()
    solvers: tuple[str, ...] = ()
    limit: float = LIMIT
    repeats: int = 3

    def __post_init__(self) -> None:
        for family in self.families:
            name, parameters = parse_label(family)
            if "bodies" in parameters:
                raise ValueError(f"{family!r} names its bodies; give sizes by --bodies")
            make_scene(name, **parameters, bodies=1)
        if any(bodies < 1 for bodies in self.bodies):
            raise ValueError(f"bodies = {min(self.bodies)}; there must be at least one")
        if not self.limit > 0:
            raise ValueError(f"limit = {self.limit}; give a positive number of seconds")
        for solver in self.solvers:
            about(solver)  # raises for an unknown one

    def sizes(self, family: str) -> list[int]:
        """Numbers of bodies, ascending."""
        more = MORE_BODIES.get(parse_label(family)[0], ())
        return sorted(set(self.bodies or (*BODIES, *more)))

    def named_solvers(self) -> tuple[str, ...]:
        """The solvers, written out."""
        there = available()
        return self.solvers or tuple(name for name in SOLVERS if name in there)


def sequence(folder: Path, family: str, bodies: int, progress: Progress | None = None) -> Recording:
    """The recording of a family at one size, from `folder` if it is there and current.

    Families are slow where the label does not say otherwise (`problems.scenes.calm`).
    """
    name, parameters = parse_label(family)
    scene = calm_scene(name, **parameters, bodies=bodies)
    how: dict[str, Any] = {"until": STEPS * STEP, "fixed_step": STEP}

    def make() -> Recording:
        counted = _Counted(make_solver("glambda"))
        try:
            run = simulate(scene, counted, **how)
        except _Enough as enough:
            run = enough.run
        rows = run.qps[0].m  # of a step, which are those of the bodies
        run = replace(run, qps=[_stored(qp, rows) for qp in run.qps])
        return recording_of(run, "glambda", until=how["until"], progress=progress)

    return recording_in(folder / "recordings", scene, how_run(scene, **how), make)


def is_enough(qps: int, columns: int) -> bool:
    """Whether so many QPs, of so many columns together, are all that is asked of a size."""
    return qps >= MOST or (qps >= LEAST and columns >= COLUMNS)


class _Enough(BaseException):
    """Enough QPs are posed, which is no fault of the solver's; `run` is the motion until then."""

    run: Run


@dataclass
class _Counted:
    """A solver whose calls are counted, and which ends the motion where these are enough."""

    solver: SolvesQPs
    calls: int = 0
    columns: int = 0

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        if is_enough(self.calls, self.columns):
            raise _Enough
        self.calls, self.columns = self.calls + 1, self.columns + qp.k
        return self.solver.solve(qp, start)


def _stored(qp: ContactQP, rows: int) -> ContactQP:
    """The QP with A dense where it is small or full, and else sparse; bodies have `rows`."""
    of_bodies = rows if qp.m >= rows else 0  # of a QR decomposition there are fewer
    A = whole_bodies(qp.A, of_bodies)
    return replace(qp, A=qp.dense_A if is_small_or_full(A) else A)


def whole_bodies(A: Matrix, rows: int) -> sp.csc_array:
    """A (m, k) in CSC with an entry for each coordinate of each body that a column touches.

    Zeros among them are stored: a box that stands straight has some, and has none once it tilts by
    1e-17.  So the pattern is the same from step to step, and a backend can keep what it made of it.
    The bodies have the first `rows`; in those that a minimum-norm QP has beyond, each entry is on
    its own: taken together by threes they would couple contacts that share no body.
    """
    entries = sp.coo_array(A)
    of_body = entries.row < rows
    first, column = entries.row[of_body] // COORDINATES, entries.col[of_body]
    places = [COORDINATES * first + i for i in range(COORDINATES)]
    zeros = np.zeros(COORDINATES * first.size)
    return sp.csc_array(
        (
            np.concatenate([entries.data, zeros]),
            (
                np.concatenate([entries.row, *places]),
                np.concatenate([entries.col, *[column] * COORDINATES]),
            ),
        ),
        shape=A.shape,
    )


def measure_growth(
    plan: Plan, folder: str | Path, *, progress: Progress | None = None
) -> pd.DataFrame:
    """Run the plan; one row per family, size and solver.

    family, bodies, m, k;  solver, arm ("warm" or "cold")
    tried : whether it was run;  reason : why it was not, or would not be at a larger size
    runtime, call_time : [s] medians over the QPs of setup + solve, and of the whole call, which
        includes what our adapter does to pose the QP;  slowest : the largest runtime
    runtime_from, runtime_to : [s] the least and the greatest median of a single pass
    verified : share of the QPs of which anything is proved;  qps : number of all;  undecided : of
        those where of nobody's answer anything is
    iterations, factorizations : means per QP, of the solver's own counting;  NaN where unknown

    Raises ValueError and ImportError as `harness.study.replay.replay` does, and StoreError where
    the folder holds results of other code.
    """
    folder = Path(folder)
    rows: list[dict[str, Any]] = []
    scenes: list[str] = []
    total = float(sum(sum(plan.sizes(family)) for family in plan.families))
    done = 0.0
    for family in plan.families:
        gone: dict[str, str] = {}
        for bodies in plan.sizes(family):
            what = f"{family}, {bodies} bodies"

            def tell(
                part: str, of: float, all_of: float, what: str = what, done: float = done,
                bodies: int = bodies,
            ) -> None:  # fmt: skip
                if progress is not None:
                    progress(f"{what}: {part}", done + bodies * of / (all_of or 1.0), total)

            tell("record", 0.0, 1.0)
            recording = sequence(folder, family, bodies)
            columns = max(qp.k for qp in recording.qps)
            size = {
                "family": family,
                "bodies": bodies,
                "m": max(qp.m for qp in recording.qps),
                "k": columns,
            }
            gone |= _too_slow(rows, family, columns, plan.limit)
            active = [name for name in plan.named_solvers() if name not in gone]
            solves = _replayed(recording, active, plan, folder, tell)
            unknown = _undecided(solves)
            for solver in plan.named_solvers():
                if solver in active:
                    row = _summary(solves[solves["solver"] == solver], unknown, plan.limit)
                    if row["reason"]:
                        gone[solver] = f"{row['reason']} at k = {size['k']:,}"
                else:
                    row = {"tried": False, "reason": gone[solver]}
                rows.append({**size, "solver": solver, **row})
                scenes.append(recording.scene)
            done += bodies
    points = pd.DataFrame(rows)
    asked = pd.MultiIndex.from_arrays([scenes, points["solver"], points["arm"]])
    ends = _ends_of_passes(folder).reindex(asked)
    return points.assign(**{f"runtime_{end}": ends[end].to_numpy() for end in ends})


def _ends_of_passes(folder: Path) -> pd.DataFrame:
    """The least and the greatest median of setup + solve of a pass, by scene, solver and arm [s].

    As everywhere, disturbed passes count where no pass was quiet.
    """
    passes = read_repeats(folder)
    told = passes[["setup_time", "solve_time", "charged_time"]].sum(axis=1, skipna=False)
    passes["runtime"] = told.fillna(passes["call_time"])
    passes["scene"] = passes["problem"].str.rpartition("/")[0]
    run = ["scene", "solver", "arm"]
    some_quiet = passes.groupby(run)["quiet"].transform("any").astype(bool)
    counted = passes[passes["quiet"].astype(bool) | ~some_quiet]
    medians = counted.groupby([*run, "repeat"])["runtime"].median()
    return medians.groupby(level=run).agg(["min", "max"]).set_axis(["from", "to"], axis=1)


def _too_slow(rows: list[dict[str, Any]], family: str, k: int, limit: float) -> dict[str, str]:
    """Backends that by the growth over their last two sizes would take `FAR` limits, and why.

    The reason is put into the row of the last size, too.
    """
    found = {}
    for solver in {row["solver"] for row in rows}:
        known = [r for r in rows if (r["family"], r["solver"]) == (family, solver) and r["tried"]]
        if len(known) < 2 or known[-1]["reason"]:
            continue
        before, last = known[-2:]
        if not 0 < before["k"] < last["k"]:
            continue
        power = log(last["call_time"] / before["call_time"]) / log(last["k"] / before["k"])
        expected = last["call_time"] * (k / last["k"]) ** min(max(1.0, power), STEEPEST)
        if expected > FAR * limit:
            found[solver] = f"{expected:.2g} s per call expected at k = {k:,}, by its growth"
            last["reason"] = found[solver]
    return found


def _replayed(
    recording: Recording, solvers: Sequence[str], plan: Plan, folder: Path, progress: Progress
) -> pd.DataFrame:
    """Rows of the replay of this recording, each solver in its best arm."""
    parts = []
    for arm in ("warm", "cold"):
        named = [s for s in solvers if ("warm" not in about(s).arms) == (arm == "cold")]
        if named:
            found = replay(
                recording,
                named,
                ("high",),
                (arm,),
                results=folder,
                repeats=plan.repeats,
                time_limit=TIMEOUT * plan.limit,
                slow_pass=SLOW_PASS,
                progress=progress,
            )
            chosen = (found["scene"] == recording.scene) & found["solver"].isin(named)
            parts.append(found[chosen & (found["arm"] == arm)])
    return pd.concat(parts) if parts else pd.DataFrame(columns=["problem", "solver", "verdict"])


def _undecided(solves: pd.DataFrame) -> set[str]:
    """Problems to which some answers are undecided and no other is known to be right or wrong."""
    open_ones, decided = (
        set(solves.loc[solves["verdict"].isin(verdicts), "problem"])
        for verdicts in (["undecided"], DECIDED)
    )
    return open_ones - decided


def _summary(solves: pd.DataFrame, unknown: set[str], limit: float) -> dict[str, Any]:
    """What is kept of one solver's rows at one size."""
    judged = solves[~solves["problem"].isin(unknown)]
    verified = float((judged["verdict"] == "verified").mean()) if len(judged) else 0.0
    call = float(solves["call_time"].median())
    reason = ""
    if verified < HALF:
        missed = solves[solves["verdict"] != "verified"]
        worst = missed["verdict"].value_counts().idxmax()
        of_these = len(judged) or len(solves)  # where nobody is known to be right or wrong
        reason = f"{round((1 - verified) * of_these)} of {of_these} not verified ({worst})"
    elif call > limit:
        reason = f"{call:.1f} s per call"
    return {
        "arm": str(solves["arm"].iloc[0]),
        "tried": True,
        "runtime": float(solves["runtime"].median()),
        "slowest": float(solves["runtime"].max()),
        "call_time": call,
        "verified": verified,
        "qps": len(solves),
        "undecided": len(solves) - len(judged),
        "iterations": _mean(solves["iterations"]),
        "factorizations": _mean(solves["qr_factorizations"]),
        "reason": reason,
    }


def _mean(counts: pd.Series) -> float:
    return float(counts.mean()) if counts.notna().any() else float("nan")


def usable(points: pd.DataFrame) -> pd.DataFrame:
    """The rows that a comparison of times may use: tried, and every answer verified."""
    return points[points["tried"].astype(bool) & (points["verified"] == 1.0)]


def exponent(k: Iterable[float], seconds: Iterable[float]) -> Exponent | None:
    """Fit time ~ k^p over the sizes from `FIT_FROM` on; None for fewer than three of them."""
    pairs = sorted((size, time) for size, time in zip(k, seconds, strict=True) if size >= FIT_FROM)
    if len(pairs) < 3:
        return None
    x, y = np.log(np.array(pairs)).T
    slopes = np.diff(y) / np.diff(x)
    p = float(np.polyfit(x, y, 1)[0])
    return Exponent(
        p, float(slopes.min()), float(slopes.max()), int(pairs[0][0]), int(pairs[-1][0])
    )
