"""Scores that speed cannot buy: who is right first, who has an answer next, who is fast last.

A backend that is wrong now and then, and fast, does well in a mean, even in one that charges it.
So the order here is lexicographic, ⟨wrong answers, unsolved, time⟩:

    wrong      it says solved, and the judge finds that it is not: claimed_wrong or inaccurate
    unsolved   every other QP that is not verified: failed, timed out, crashed, undecided
    time       shifted geometric mean over the common QPs, each not verified charged the limit

Beside it stands PAR-2, as competitions of solvers have it: the arithmetic mean of the times, each
that is not verified charged twice the limit.  It is in seconds where one QP in a million is lost.
"""

from __future__ import annotations

import pandas as pd

from reports.parts.names import solver_order
from reports.parts.table import Table, microseconds, whole
from reports.rows.comparison import SHIFT, compare, pool, shifted_geometric_mean
from reports.rows.results import Results

PENALTY = 2.0
"""Of PAR-2: times the limit that a QP is charged that is not verified."""
WRONG = ("claimed_wrong", "inaccurate")


def scores(rows: pd.DataFrame, time_limit: float) -> pd.DataFrame:
    """wrong, unsolved, mean [s] and PAR-2 [s] of each solver, the first in rank first.

    rows : of compared runs on common QPs
    """
    out = []
    for solver, part in rows.groupby("solver"):
        missed = ~part["verified"]
        wrong = missed & part["verdict"].isin(WRONG) & part["found"].astype(bool)
        par = part["runtime"].where(part["verified"], PENALTY * time_limit)
        out.append(
            {
                "solver": str(solver),
                "QPs": len(part),
                "wrong": int(wrong.sum()),
                "unsolved": int((missed & ~wrong).sum()),
                "mean": shifted_geometric_mean(part["charged"]),
                "PAR-2": par.mean(),
            }
        )
    columns = ["solver", "QPs", "wrong", "unsolved", "mean", "PAR-2"]
    data = pd.DataFrame(
        sorted(out, key=lambda row: solver_order(str(row["solver"]))), columns=columns
    )
    return data.sort_values(["wrong", "unsolved", "mean"], kind="stable", ignore_index=True)


def ranking_table(results: Results, setting: str, arm: str) -> Table:
    """The order over all scenes, of who was compared on every one of them."""
    compared = [compare(results.rows, scene, setting, arm) for scene in results.scenes]
    data = scores(pool(compared), results.time_limit)
    by_mean = data["mean"].rank(method="min")
    by_par = data["PAR-2"].rank(method="min")
    data.insert(0, "rank", range(1, len(data) + 1))
    data["by mean"], data["by PAR-2"] = by_mean, by_par
    return Table(
        name="ranking",
        key={"setting": setting},
        title="Who is right, who has an answer, who is fast",
        reading=(
            "In the order of wrong answers (it says solved and is not), then of unsolved QPs, then "
            f"of time: the shifted geometric mean with shift {1e6 * SHIFT:g} µs, where a QP that "
            f"is not verified is charged {results.time_limit:g} s.  PAR-2 is the arithmetic mean "
            f"where it is charged {PENALTY:g} times as much.  Times in µs, over the QPs of all "
            f"scenes that nobody skipped, {'warm where there is a warm start' * (arm == 'warm')}"
            f"{'cold' * (arm == 'cold')}; by mean and by PAR-2 are the ranks by these alone."
        ),
        data=data,
        formats={
            **dict.fromkeys(["rank", "QPs", "wrong", "unsolved", "by mean", "by PAR-2"], whole),
            **dict.fromkeys(["mean", "PAR-2"], microseconds),
        },
        notes=_bought(data),
    )


def _bought(data: pd.DataFrame) -> list[str]:
    """Whom speed alone would have put further ahead than being right does."""
    return [
        f"{row['solver']} would be number {int(row['by mean'])} by its mean, and is number "
        f"{row['rank']}: {row['wrong']:,} wrong answers, {row['unsolved']:,} unsolved."
        for row in data.to_dict("records")
        if row["by mean"] < row["rank"] and row["wrong"] + row["unsolved"] > 0
    ]
