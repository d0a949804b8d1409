"""The tables of a study: scenes, accuracy, cost, and what a warm start is worth.

All are made from stored rows and recordings alone.  Which runs are compared, on which QPs and by
what mean is the business of `reports.rows.comparison`; the table on the criterion for
refactorization is in `reports.sections.thresholds`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from harness.judging.facts import UNKNOWN, rank_of
from harness.names import is_own
from problems.qp import KINDS
from reports.parts.intervals import SURE, geometric_mean
from reports.parts.names import solver_order
from reports.parts.table import Format, Table, microseconds, percent, scientific, times, whole
from reports.rows.comparison import SHIFT, Comparison, compare, shifted_geometric_mean
from reports.rows.results import ARMS, METHOD, Results

SUFFIXES = ("_cold", "_warm")

SLOWER = 1.02
"""Ratio from which a warm start is said to cost more than it saves; less is noise of the clock."""


def scene_table(results: Results) -> Table:
    """How large and how hard each scene is: steps, QPs by kind, impulses, restarts, k, rank."""
    data = pd.DataFrame([_scene_row(results, scene) for scene in results.scenes])
    numbers = [name for name in data.columns if name not in ("scene", "rank deficient", "until")]
    return Table(
        name="scenes",
        title="The scenes",
        reading=(
            "One line per scene.  A step is accepted or rejected by the error control (3.5); each "
            "poses a QP, and a functional iteration (3.9) or a friction correction poses more.  "
            "k is the number of multipliers of a QP.  Where A lacks full column rank λ is not "
            "unique and only Gλ can be compared."
        ),
        data=data,
        formats={
            **dict.fromkeys(numbers, whole),
            "until": lambda t: f"{t:.2f} s",
            "rank deficient": percent,
        },
    )


def qps_of(results: Results, scene: str) -> pd.DataFrame:
    """One row per QP of a scene: kind, accepted, restart, t, m, k, rank; from the recording, or
    from the rows where it is not stored.  rank counts σ > 1e-10 σ_max."""
    recording = results.recordings.get(scene)
    if recording is None:
        rows = results.rows[results.rows["scene"] == scene]
        columns = ["problem", "kind", "accepted", "restart", "t", "m", "k", "rank"]
        return rows[columns].drop_duplicates("problem").reset_index(drop=True)
    qps = recording.qps
    return pd.DataFrame(
        {
            **{
                name: [getattr(qp, name) for qp in qps]
                for name in ("kind", "accepted", "restart", "t", "m", "k")
            },
            "rank": [rank_of(qp) for qp in qps],
        }
    )


def _scene_row(results: Results, scene: str) -> dict[str, Any]:
    qps = qps_of(results, scene)
    recording = results.recordings.get(scene)
    accepted, kind = qps["accepted"].astype(bool), qps["kind"]
    row: dict[str, Any] = {"scene": scene}
    if recording is None:
        row["until"] = qps["t"].max()
        row["steps"] = int((accepted & (kind == "step")).sum())
        row["rejected"] = int((~accepted & (kind == "step")).sum())
    else:
        # a step may pose several QPs, or be kept without one: the stepper's own counts tell
        row["until"] = float(recording.t[-1]) if len(recording.t) else np.nan
        row["steps"] = recording.counts.get("steps", np.nan)
        row["rejected"] = recording.counts.get("rejected_steps", np.nan)
    row["QPs"] = len(qps)
    for name in KINDS:
        row[name.replace("_", " ")] = int((kind == name).sum())
    row["restarts"] = int(qps["restart"].astype(bool).sum())
    row["median k"], row["max k"] = qps["k"].median(), qps["k"].max()
    ranked = qps[qps["rank"] != UNKNOWN]
    row["rank deficient"] = float((ranked["rank"] < ranked["k"]).mean()) if len(ranked) else np.nan
    return row


def accuracy_table(results: Results, setting: str) -> Table:
    """Error in Gλ and share verified, per scene and solver, both arms together."""
    rows = results.rows[results.rows["settings"] == setting]
    out = []
    for (scene, solver), part in rows.groupby(["scene", "solver"]):
        done = part[~part["skipped"]]
        counts = done["verdict"].value_counts()
        undecided = int(counts.get("undecided", 0))
        misses = len(done) - int(done["verified"].sum()) - undecided
        out.append(
            {
                "scene": scene,
                "solver": solver,
                "solves": len(done),
                "verified": done["verified"].mean() if len(done) else np.nan,
                "misses": misses,
                "claimed wrong": int(counts.get("claimed_wrong", 0)),
                "no answer": int(sum(counts.get(v, 0) for v in ("failed", "timeout", "crashed"))),
                "undecided": undecided,
                "skipped": len(part) - len(done),
                "eps0 ratio, median": done["eps0_ratio"].median(),
                "eps0 ratio, max": done["eps0_ratio"].max(),
                "Gλ error, median": done["glambda_error"].median(),
                "Gλ error, max": done["glambda_error"].max(),
            }
        )
    data = pd.DataFrame(sorted(out, key=_place))
    asked = {
        "paper": "the accuracy (3.13) that the stepper needs, ε₀ of each QP",
        "high": "1e-9 of the scale",
        "default": "each package's own default, judged at 1e-6 of the scale",
    }.get(setting, "as given")
    counts_format = dict.fromkeys(
        ["solves", "misses", "claimed wrong", "no answer", "undecided", "skipped"], whole
    )
    errors = [name for name in data.columns if "ratio" in name or "error" in name]
    return Table(
        name="accuracy",
        key={"setting": setting},
        title="Accuracy",
        reading=(
            f"Asked: {asked}.  Gλ error is ‖A(x − x*)‖ over the scale ‖A A⁺d‖, and eps0 ratio the "
            "same over ε₀; x* is the checked reference.  A solve is verified up to 10 times what "
            "was asked, by the judge and not by the solver's word; undecided where neither that "
            "nor the contrary is proved; a miss is any other solve, claimed wrong among them one "
            "that was called solved at more than 1000 times.  Cold and warm solves are counted "
            "together."
        ),
        data=data,
        formats={**counts_format, "verified": percent, **dict.fromkeys(errors, scientific)},
        notes=_miss_notes(data),
    )


def _place(row: dict[str, Any]) -> tuple[str, tuple[bool, str]]:
    return row["scene"], solver_order(row["solver"])


def _miss_notes(data: pd.DataFrame) -> list[str]:
    """Who missed, in words; our method first."""
    if data.empty:
        return []
    notes = []
    own = data[(data["solver"] == METHOD) & (data["misses"] > 0)]
    for row in own.to_dict("records"):
        notes.append(
            f"On {row['scene']} {METHOD} misses {row['misses']:,} of {row['solves']:,} solves."
        )
    totals = data.groupby("solver")[["misses", "claimed wrong", "solves"]].sum()
    others = totals[(totals["misses"] > 0) & (totals.index != METHOD)]
    for solver in sorted(others.index, key=solver_order):
        missed, wrong, solves = (int(value) for value in others.loc[solver])
        text = f"{solver} misses {missed:,} of {solves:,} solves"
        notes.append(
            text
            + (f", {wrong:,} of them by more than 1000 times and called solved." if wrong else ".")
        )
    if unknown := int(data["undecided"].sum()):
        notes.append(f"Of {unknown:,} solves nothing is proved: they are undecided.")
    return notes or ["Every solve of every backend is verified."]


def verified_table(results: Results, setting: str) -> Table:
    """Share verified, one line per solver and one column per scene."""
    rows = results.rows[(results.rows["settings"] == setting) & ~results.rows["skipped"]]
    shares = rows.pivot_table(index="solver", columns="scene", values="verified", aggfunc="mean")
    shares = shares.loc[sorted(shares.index, key=solver_order)] if len(shares) else shares
    shares.columns.name = None
    scenes = list(shares.columns)
    return Table(
        name="verified",
        key={"setting": setting},
        title="Who reproduces Gλ",
        reading=(
            "Share of the solves that the judge verified.  100 % means every one; a dash that the "
            "backend skipped them all."
        ),
        data=shares.reset_index(),
        formats=dict.fromkeys(scenes, percent),
    )


def cost_table(results: Results, setting: str) -> Table:
    """Time per QP, cold and as in a simulation, per scene and solver."""
    out, notes = [], []
    for scene in results.scenes:
        comparisons = {arm: compare(results.rows, scene, setting, arm) for arm in ARMS}
        summaries = {arm: comparisons[arm].summary() for arm in ARMS}
        solvers = sorted({s for table in summaries.values() for s in table.index}, key=solver_order)
        for solver in solvers:
            row: dict[str, Any] = {
                "scene": scene,
                "solver": solver,
                "warm start": "no" if solver in comparisons["warm"].without_warm else "yes",
            }
            for arm in ARMS:
                table, known = summaries[arm], solver in summaries[arm].index
                for name, column in (
                    ("median", f"{arm} median"),
                    ("ratio", f"{arm} ÷ best"),
                    ("mean", f"{arm} mean"),
                    ("verified", f"{arm} verified"),
                ):
                    row[column] = table.at[solver, name] if known else np.nan
            out.append(row)
        notes += [note for arm in ARMS for note in losses(comparisons[arm])]
        for arm in ARMS:
            notes += _comparison_notes(comparisons[arm])
    data = pd.DataFrame(out)
    formats: dict[str, Format] = {}
    for arm in ARMS:
        formats |= dict.fromkeys([f"{arm} median", f"{arm} mean"], microseconds)
        formats |= {f"{arm} ÷ best": times, f"{arm} verified": percent}
    return Table(
        name="cost",
        key={"setting": setting},
        title="Time per QP in µs",
        reading=(
            "Setup and solve inside the package's own call; building its arrays is not counted.  "
            "median is over the QPs of the scene, as measured; ÷ best is that median over the one "
            "of the fastest backend that was verified on every QP (1×).  mean is the shifted "
            f"geometric mean with shift {1e6 * SHIFT:g} µs in which a solve that is not verified "
            f"is charged {results.time_limit:g} s.  All numbers of a scene run over the same QPs, "
            "those that have a multiplier and that no compared backend skipped.  A backend without "
            "a warm start stands under warm with its cold times, as it would cost in a simulation."
        ),
        data=data,
        formats=formats,
        notes=notes,
    )


def losses(comparison: Comparison) -> list[str]:
    """Where our method is beaten by a backend verified on every QP, in words."""
    table = comparison.summary()
    where = f"On {comparison.scene} ({comparison.arm}, {comparison.setting})"
    if METHOD not in table.index:
        return []
    own = table.loc[METHOD]
    if own["verified"] < 1:
        missed = comparison.rows[
            (comparison.rows["solver"] == METHOD) & ~comparison.rows["verified"]
        ]
        return [f"{where} {METHOD} is not verified on {len(missed)} of {comparison.common} QPs."]
    if not table["best"].any() or own["best"]:
        return []
    best = table[table["best"]].iloc[0]
    ratio = own["median"] / best["median"]
    return [
        f"{where} {best.name} is {times(ratio)} faster than {METHOD} "
        f"({microseconds(best['median'])} µs against {microseconds(own['median'])} µs)."
    ]


def _comparison_notes(comparison: Comparison) -> list[str]:
    """What was compared on fewer QPs, left out, or stood in with its cold arm."""
    where = f"{comparison.scene}, {comparison.arm}"
    notes = []
    if comparison.common < comparison.qps:
        notes.append(
            f"{where}: {comparison.common:,} of {comparison.qps:,} QPs are compared; "
            "some compared backend skipped the others."
        )
    for entry in comparison.left_out:
        notes.append(
            f"{where}: {entry.solver} is left out, it solved {entry.solved:,} of {entry.of:,} "
            f"QPs ({entry.reason})."
        )
    if len(comparison.machines) > 1:
        notes.append(
            f"{where}: times of {comparison.machines[0]} only; "
            f"{len(comparison.machines) - 1} other machines gave accuracy alone."
        )
    return notes


def warm_table(results: Results, setting: str) -> Table:
    """What a warm start is worth: each warm arm against its own cold twin, on the same QPs."""
    out = []
    for scene in results.scenes:
        pairs = warm_pairs(results.rows, scene, setting)
        for solver, part in pairs.groupby("solver"):
            out.append({"scene": scene, **warm_row(str(solver), part)})
    data = pd.DataFrame(sorted(out, key=_place))
    return Table(
        name="warm_start",
        key={"setting": setting},
        title="What a warm start is worth",
        reading=(
            "Each backend against itself: the same QPs solved from nothing and from its own "
            "previous answer, mapped by row.  The first QP after a discontinuity is left out, and "
            "so are impulses and minimum-norm problems.  pairs are the QPs verified both ways; "
            "means are shifted geometric means in µs.  time ratio is the geometric mean of warm "
            f"over cold, QP by QP, with the range of {percent(SURE)} of resampled sequences; below "
            "1 is a gain.  one direction: share of QPs that our method, or the paper's, solves "
            "with at most one descent direction."
        ),
        data=data,
        formats={
            "QPs": whole,
            "pairs": whole,
            **dict.fromkeys(["cold mean", "warm mean"], microseconds),
            **dict.fromkeys(["time ratio", "from", "to", "iteration ratio"], times),
            **dict.fromkeys([f"one direction, {arm}" for arm in ARMS], percent),
        },
        notes=_warm_notes(data),
    )


def warm_row(solver: str, pairs: pd.DataFrame) -> dict[str, Any]:
    """Warm against cold of one solver, on the pairs that are verified both ways."""
    both = pairs[pairs["verified_cold"] & pairs["verified_warm"]]
    cold, warm = (shifted_geometric_mean(both[f"runtime{suffix}"]) for suffix in SUFFIXES)
    iterations = both["iterations_cold"].sum()
    ratio = geometric_mean(both["runtime_warm"] / both["runtime_cold"])
    row = {
        "solver": solver,
        "QPs": len(pairs),
        "pairs": len(both),
        "cold mean": cold,
        "warm mean": warm,
        "time ratio": ratio.mean,
        "from": ratio.low,
        "to": ratio.high,
        "iteration ratio": both["iterations_warm"].sum() / iterations if iterations else np.nan,
    }
    for arm in ARMS:
        counted = both[f"descent_directions_{arm}"].dropna()
        known = len(counted) > 0 and is_own(solver)
        row[f"one direction, {arm}"] = (counted <= 1).mean() if known else np.nan
    return row


def _warm_notes(data: pd.DataFrame) -> list[str]:
    if data.empty:
        return []
    slower = data[data["time ratio"] > SLOWER]
    return [
        f"On {row['scene']} a warm start makes {row['solver']} slower: "
        f"{times(row['time ratio'])} its cold time."
        for row in slower.to_dict("records")
    ]


def slow_starts(results: Results, setting: str) -> list[str]:
    """Scenes on which our method is slower when it is started warm, in words."""
    said = []
    for scene in results.scenes:
        pairs = warm_pairs(results.rows, scene, setting)
        row = warm_row(METHOD, pairs[pairs["solver"] == METHOD])
        if row["time ratio"] > SLOWER:
            said.append(
                f"On {scene} ({setting}) a warm start makes {METHOD} slower: "
                f"{times(row['time ratio'])} its cold time."
            )
    return said


def warm_pairs(rows: pd.DataFrame, scene: str, setting: str) -> pd.DataFrame:
    """Cold and warm rows side by side, one row per (solver, QP) that was started warm.

    Columns end in `_cold` and `_warm`.  QPs that the warm arm too had to solve from nothing are
    left out: impulses, minimum-norm problems, and whatever follows a restart; and so are those of
    free flight, which have no multiplier.
    """
    part = rows[(rows["scene"] == scene) & (rows["settings"] == setting) & ~rows["skipped"]]
    part = part[part["k"] > 0]
    columns = ["solver", "problem", "runtime", "iterations", "descent_directions", "verified"]
    cold = part.loc[part["arm"] == "cold", columns]
    started = (part["arm"] == "warm") & part["warm_started"].astype(bool)
    return cold.merge(part.loc[started, columns], on=["solver", "problem"], suffixes=SUFFIXES)
