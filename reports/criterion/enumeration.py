"""Guessing the active set beside algorithm 2: a table by size and what it says.

Its numbers are those of `harness.criterion.enumeration_growth`.
"""

from __future__ import annotations

from math import inf, isfinite, nan

import pandas as pd

from harness.criterion.enumeration_growth import MOST_SETS, fit_base, loses_from, medians
from harness.criterion.examination import Examination
from reports.parts.sentences import join
from reports.parts.table import Table, microseconds, percent, short, times, whole


def enumeration_table(examination: Examination) -> Table:
    """Sets tried and time against k, on recorded and on random QPs."""
    rows = []
    for each, name in ((examination.enumeration, "recorded"), (examination.random, "random")):
        for k, size in each.groupby("k"):
            cold, warm = size[size["arm"] == "cold"], size[size["arm"] == "warm"]
            if cold.empty:  # met warm only
                continue
            median = medians(cold).loc[k]
            own = median["seconds"] if isfinite(median["seconds"]) else nan
            rows.append(
                {
                    "QPs of": name,
                    "k": k,
                    "QPs": len(cold),
                    "at once": float((cold["sets"] == 1).mean()),
                    "at once, warm": float((warm["sets"] == 1).mean()),
                    "sets": median["sets"],
                    "mean": cold["sets"].mean(),
                    "most": cold["sets"].max(),
                    "given up": int(cold["sets"].isna().sum()),
                    "directions": cold["directions"].mean(),
                    "µs": own,
                    "method µs": median["method_seconds"],
                    "ratio": own / median["method_seconds"],
                }
            )
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_enumeration",
        title="Guessing the active set",
        reading=(
            "QPs of k rows that are not fixed, of the recordings and random.  at once is the "
            "share whose first guess is right, cold (least squares without bounds) and warm (the "
            "set of the QP before).  sets is the median of the sets tried cold, one linear system "
            f"each, and mean and most those of the QPs not given up after {MOST_SETS:,}.  "
            "directions are the linear systems that our method solves (mean); µs the "
            "median times side by side, and their ratio."
        ),
        data=data,
        formats={
            **dict.fromkeys(["k", "QPs", "most", "given up"], whole),
            **dict.fromkeys(["at once", "at once, warm"], percent),
            **dict.fromkeys(["mean", "directions"], short),
            "sets": lambda sets: short(sets) if isfinite(sets) else f"> {MOST_SETS:,}",
            **dict.fromkeys(["µs", "method µs"], microseconds),
            "ratio": times,
        },
        notes=[*_recorded_notes(examination.enumeration), *_random_notes(examination.random)],
    )


def _recorded_notes(recorded: pd.DataFrame) -> list[str]:
    """What guessing costs on the recordings, and when its guess is poor."""
    notes, worse = [], []
    for scene, one in recorded.groupby("scene", sort=False):
        cold, warm = one[one["arm"] == "cold"], one[one["arm"] == "warm"]
        if (warm["sets"] == 1).mean() < (cold["sets"] == 1).mean():
            worse.append(str(scene))
        lost = int(cold["sets"].isna().sum())
        most = cold.loc[cold["sets"].idxmax()] if lost < len(cold) else None
        notes.append(
            f"On {scene} the first guess is right at {percent((cold['sets'] == 1).mean())} of "
            f"{len(cold):,} QPs; the mean is {short(cold['sets'].mean())} sets against "
            f"{short(cold['directions'].mean())} directions"
            + ("" if most is None else f", the most {whole(most['sets'])} (k = {most['k']})")
            + (f"; {lost} QPs were given up." if lost else ".")
        )
    if worse:
        notes.append(
            f"On {join(worse)} the set of the QP before is the poorer guess of the two: least "
            "squares sees today's forces."
        )
    return notes


def _random_notes(random: pd.DataFrame) -> list[str]:
    """Growth, and where enumeration loses."""
    if random.empty:
        return []
    notes = []
    sets, own = fit_base(random, "sets"), fit_base(random, "seconds")
    method = fit_base(random, "method_seconds")
    if isfinite(sets.base):
        finite = medians(random)["sets"]
        last = finite.index[finite < inf].max()
        notes.append(
            f"On random QPs the sets grow as {sets.factor:.2g} · {sets.base:.2f}ᵏ, the time as "
            f"{own.base:.2f}ᵏ and that of our method as {method.base:.2f}ᵏ (fitted "
            f"to the medians up to k = {last})."
        )
    if medians(random)["sets"].iloc[-1] == inf:
        notes.append(
            f"At k = {random['k'].max()} half of them are given up after {MOST_SETS:,} sets: that "
            "is its limit."
        )
    systems = loses_from(random, "sets", "directions")
    seconds = loses_from(random, "seconds", "method_seconds")
    if systems is not None:
        notes.append(
            f"It solves more linear systems than our method from k = {systems} on: there "
            "it would lose even if a set cost no more than a direction."
        )
    if seconds is not None:
        first = random[random["k"] == random["k"].min()]
        apart = first["seconds"].median() / first["method_seconds"].median()
        notes.append(
            f"In time it loses from k = {seconds} on."
            + (
                f"  At k = {first['k'].min()} the ratio of {short(apart)} is that of interpreted "
                "to compiled code, not of two methods."
                if seconds == first["k"].min()
                else ""
            )
        )
    return notes
