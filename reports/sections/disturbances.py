"""What disturbed QPs do to a backend: those of `glambda disturb` against their originals.

QP i of a disturbed recording is QP i of its original, numbered or scaled otherwise, with contacts
repeated, or with noise.  For each backend and disturbance, over all recordings that were replayed
both ways:

    verified   share of the disturbed QPs, beside that of the same QPs as they were recorded
    time       geometric mean of disturbed over original, QP by QP, verified both ways, with an
               interval from resampling (`reports.parts.intervals`)

    relative   the same over the median of all backends: recordings are replayed one after the
               other, so that what all share is the machine's state, and for duplicated contacts
               that k is up to twice as large
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from harness.names import DISTURBED
from harness.study.disturb import EVERY_KIND
from reports.parts.intervals import SURE, geometric_mean
from reports.parts.names import in_order, solver_order
from reports.parts.sentences import join
from reports.parts.table import Table, percent, short, times, whole
from reports.rows.results import Results

SAME = ("permuted", "scaled")
"""Disturbances under which a QP is the same in all but its numbers."""
NOTABLE = 0.05
"""Change of a time that is worth a word."""


def disturbed_pairs(results: Results) -> pd.DataFrame:
    """One row per disturbed solve with its original: `kind`, and columns of both.

    The setting is the first that has any, the arm warm where there is one, else cold.
    """
    rows = results.everything
    rows = rows[(rows["k"] > 0) & ~rows["skipped"] & rows["arm"].isin(["cold", "warm"])]
    is_disturbed = rows["scene"].str.contains(DISTURBED, regex=False)
    settings = in_order(rows.loc[is_disturbed, "settings"].unique(), tuple(results.settings))
    if not settings:
        return pd.DataFrame()
    rows = rows[rows["settings"] == settings[0]]
    split = rows["problem"].str.rpartition("/")
    scene = split[0].str.partition(DISTURBED)
    rows = rows.assign(kind=scene[2], original=scene[0] + "/" + split[2])
    key = ["solver", "arm", "original"]
    columns = [*key, "verified", "runtime", "iterations", "verdict"]
    before = rows.loc[rows["kind"] == "", columns]
    after = rows.loc[rows["kind"] != "", [*columns, "kind", "settings"]]
    pairs = after.merge(before, on=key, suffixes=("", "_before"))
    warm = pairs["solver"].map(pairs.groupby("solver")["arm"].agg(lambda arm: "warm" in set(arm)))
    pairs = pairs[pairs["arm"] == np.where(warm, "warm", "cold")]
    return pairs.sort_values(["solver", "kind", "original"], kind="stable", ignore_index=True)


def disturbances_table(results: Results) -> Table | None:
    """Verified share and change of time, backend by backend; None where nothing was disturbed."""
    pairs = disturbed_pairs(results)
    if pairs.empty:
        return None
    rows = []
    for solver in sorted(pairs["solver"].unique(), key=solver_order):
        for kind in in_order(pairs["kind"].unique(), EVERY_KIND):
            part = pairs[(pairs["solver"] == solver) & (pairs["kind"] == kind)]
            if part.empty:
                continue
            both = part[part["verified"] & part["verified_before"]]
            ratio, iterations = (
                geometric_mean(both["runtime"] / both["runtime_before"]),
                both["iterations_before"].sum(),
            )
            rows.append(
                {
                    "solver": solver,
                    "disturbed": kind,
                    "QPs": len(part),
                    "verified": part["verified"].mean(),
                    "before": part["verified_before"].mean(),
                    "claimed wrong": int((part["verdict"] == "claimed_wrong").sum()),
                    "time": ratio.mean,
                    "from": ratio.low,
                    "to": ratio.high,
                    "relative": np.nan,
                    "iterations": both["iterations"].sum() / iterations if iterations else np.nan,
                }
            )
    data = pd.DataFrame(rows)
    shared = data.groupby("disturbed")["time"].transform("median")
    data["relative"] = data["time"] / shared
    return Table(
        name="disturbances",
        key={"setting": str(pairs["settings"].iloc[0])},
        title="Disturbed QPs against their originals",
        reading=(
            "permuted: contacts and bodies in another order.  scaled: each multiplier in a unit of "
            "its own, half of them with the other sign.  duplicated: half of the contacts twice.  "
            "A number: relative noise in A and d.  verified is the share of the disturbed QPs, "
            "before that of the same QPs as recorded; time is the geometric mean of disturbed over "
            f"original, verified both ways, with the range of {percent(SURE)} of resampled "
            "sequences, and relative the same over the median of all backends, which is the "
            "machine's doing.  Backends stand warm where they have a warm start."
        ),
        data=data,
        formats={
            **dict.fromkeys(["QPs", "claimed wrong"], whole),
            **dict.fromkeys(["verified", "before"], percent),
            **dict.fromkeys(["time", "from", "to", "relative", "iterations"], times),
        },
        notes=_notes(data),
    )


def _notes(data: pd.DataFrame) -> list[str]:
    """Who verifies less than before, and whom another order or other units slow down."""
    said = []
    worse = data[data["verified"] < data["before"]]
    for kind, part in worse.groupby("disturbed", sort=False):
        listed = [
            f"{row['solver']} ({percent(row['verified'])}, was {percent(row['before'])})"
            for row in part.to_dict("records")
        ]
        said.append(f"{_named(str(kind))} fewer are verified of {join(listed, 12)}.")
    low = data["from"] * data["relative"] / data["time"]
    slower = data[data["disturbed"].isin(SAME) & (low > 1 + NOTABLE)]
    for kind, part in slower.groupby("disturbed", sort=False):
        listed = [f"{row['solver']} ({short(row['relative'])})" for row in part.to_dict("records")]
        said.append(f"{_named(str(kind))} these take longer than others: {join(listed, 12)}.")
    return said or ["Nobody is verified less often, nor slower than others by order or units."]


def _named(kind: str) -> str:
    words = {
        "permuted": "In another order",
        "scaled": "In other units and signs",
        "duplicated": "With contacts duplicated",
    }
    return words.get(kind, f"With noise of {kind}")
