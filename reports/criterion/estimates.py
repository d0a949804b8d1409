"""Are algorithm 2's estimates, ranks and accuracy what it takes them for: tables and their notes.

    criterion_norms         Cline's estimate of ‖R⁻¹‖ and Karasalo's bound against singular values
    criterion_rank          ranks decided by its QR and by the bound alone, and by the SVD
    criterion_old_R         ‖R⁻¹‖ of an R that is kept, against that of today's A_F
    criterion_accuracy      ‖A δx‖/ε₀ at setting `paper`
    criterion_directions    the same by descent directions and by the age of R

Their numbers are those of `harness.criterion.estimates` and `harness.criterion.accuracy`.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from harness.criterion.accuracy import SAFETY, SOLVERS, STARTS
from harness.criterion.examination import Examination
from harness.names import METHOD
from reports.parts.sentences import join
from reports.parts.table import Table, percent, short, whole

AGES = {"1": (1, 1), "2–5": (2, 5), "6–20": (6, 20), "> 20": (21, 10**9)}
"""Classes of age of an R that is kept."""
THIN = 30
"""Solves of a class below which its worst says little."""
NEARLY_SINGULAR = 1e-6
"""σ_min/σ_max at which a rank becomes a matter of judgement."""
NOISE = 1e-13
"""σ/σ_max that is rounding."""


def norms_table(examination: Examination) -> Table:
    """Cline's estimate and Karasalo's bound against the singular values of R."""
    rows = []
    for scene, columns, norms in _by_columns(examination):
        cline, karasalo = norms["inverse"] / norms["estimate"], norms["bound"] * norms["inverse"]
        rows.append(
            {
                "scene": scene,
                "columns": columns,
                "QPs": len(norms),
                "n": norms["n"].median(),
                "Cline": cline.median(),
                "95 %": cline.quantile(0.95),
                "worst": cline.max(),
                "Karasalo": karasalo.median(),
                "5 %": karasalo.quantile(0.05),
                "least": karasalo.min(),
            }
        )
    data = pd.DataFrame(rows)
    notes = []
    if len(data):
        worst, least = data.loc[data["worst"].idxmax()], data.loc[data["least"].idxmin()]
        notes = [
            f"‖R⁻¹‖ is at most {short(worst['worst'])} times its estimate ({worst['scene']}, "
            f"{worst['columns']} columns); (3.20) is too loose by that factor, of which the "
            f"method's ε₀/{SAFETY:g} takes care.",
            f"Karasalo's bound is down to {short(least['least'])} of σ_min ({least['scene']}, "
            f"{least['columns']} columns): too small by up to {1 / least['least']:.2g}, where "
            f"the estimate is too small by {short(worst['worst'])} at most.",
        ]
    return Table(
        name="criterion_norms",
        title="‖R⁻¹‖ estimated, and σ_min bounded",
        reading=(
            "R is algorithm 2's factorization of n columns (median) of length 1: the free ones, "
            "whose multipliers lie between their bounds, or all of the QP.  Cline is the true "
            "‖R⁻¹‖ over its estimate, never below 1: median, 95th percentile, worst.  Karasalo "
            "is the bound over the true σ_min of R, never above 1: median, 5th percentile, least."
        ),
        data=data,
        formats={"QPs": whole, **dict.fromkeys(data.columns[3:], short)},
        notes=notes + _too_large(examination),
    )


def rank_table(examination: Examination) -> Table:
    """Ranks by algorithm 2's QR and by Karasalo's bound against the SVD."""
    rows, notes = [], []
    for scene, columns, norms in _by_columns(examination):
        rows.append(
            {
                "scene": scene,
                "columns": columns,
                "QPs": len(norms),
                "deficient": float((norms["rank"] < norms["n"]).mean()),
                "QR = SVD": float((norms["qr_rank"] == norms["rank"]).mean()),
                "Karasalo = SVD": float((norms["karasalo_rank"] == norms["rank"]).mean()),
                "least σ": norms["last"].min(),
                "next σ": norms["next"].max(),
            }
        )
        for column, name in (("qr_rank", "the QR"), ("karasalo_rank", "Karasalo's bound")):
            other = norms[norms[column] != norms["rank"]]
            if len(other):
                said = [
                    f"QP {row.place} ({getattr(row, column)} against {row.rank} of {row.n})"
                    for row in other.itertuples()
                ]
                notes.append(f"On {scene}, {columns} columns, {name} differs at {join(said)}.")
    data = pd.DataFrame(rows)
    if len(data) and not notes:
        notes.append("QR, Karasalo's bound and SVD agree on every rank.")
    if len(data) and data["least σ"].min() > NEARLY_SINGULAR > NOISE > data["next σ"].max():
        notes.append(
            "It is no hard test of the QR: every singular value that counts exceeds "
            f"{short(data['least σ'].min())} σ_max, and the others are rounding."
        )
    return Table(
        name="criterion_rank",
        title="Ranks against the SVD",
        reading=(
            "deficient is the share of QPs whose columns depend on each other (σ ≤ 1e-10 σ_max); "
            "then the shares on which algorithm 2's QR, and Karasalo's bound alone at 1e-10, find "
            "the rank of the SVD.  least σ is the smallest σ/σ_max that the QR counts, next σ the "
            "largest that it does not."
        ),
        data=data,
        formats={
            "QPs": whole,
            **dict.fromkeys(["deficient", "QR = SVD", "Karasalo = SVD"], percent),
            **dict.fromkeys(["least σ", "next σ"], short),
        },
        notes=notes,
    )


def kept_table(examination: Examination) -> Table:
    """‖R⁻¹‖ of an R that is kept against that of today's A_F."""
    rows = []
    for (_, scene), of_scene in examination.ages.groupby(["digest", "scene"], sort=False):
        for name, (first, last) in AGES.items():
            pairs = of_scene[of_scene["age"].between(first, last)]
            aged, short_by = pairs["today"] / pairs["then"], pairs["today"] / pairs["estimate_then"]
            if len(pairs):
                rows.append(
                    {
                        "scene": scene,
                        "s": name,
                        "pairs": len(pairs),
                        "dependent": float(pairs["today"].isna().mean()),
                        "grown": aged.median(),
                        "95 %": aged.quantile(0.95),
                        "worst": aged.max(),
                        "over estimate": short_by.median(),
                        "worst of it": short_by.max(),
                    }
                )
    data = pd.DataFrame(rows)
    notes = []
    if len(data):
        worst = data.loc[data["worst of it"].idxmax()]
        allowed = "within" if worst["worst of it"] <= SAFETY else "beyond"
        notes.append(
            f"With a kept R, (3.20) is too loose by up to {short(worst['worst of it'])} "
            f"({worst['scene']}, s {worst['s']}), {allowed} the factor of {SAFETY:g} that the "
            "method allows for it."
        )
    return Table(
        name="criterion_old_R",
        title="‖R⁻¹‖ of an R that is kept",
        reading=(
            "Pairs of QPs of one stretch s apart, with the free columns of the later one: grown "
            "is ‖R⁻¹‖ today over what it was (median, 95th percentile, worst); over estimate, the "
            "same over Cline's estimate then, which is what algorithm 2 divides ε₀ by.  dependent "
            "is the share where the columns were, or are, dependent."
        ),
        data=data,
        formats={
            "pairs": whole,
            "dependent": percent,
            **dict.fromkeys(data.columns[4:], short),
        },
        notes=notes,
    )


def accuracy_table(examination: Examination) -> Table:
    """‖A δx‖/ε₀, the worst by recording, solver and start."""
    asked, printed = _asked(examination)
    rows = []
    for scene in examination.scenes:
        for solver in SOLVERS:
            own = asked[(asked["scene"] == scene) & (asked["solver"] == solver)]
            loose = printed[(printed["scene"] == scene) & (printed["solver"] == solver)]
            if not len(own):
                continue
            row: dict[str, Any] = {"scene": scene, "solver": solver, "solves": len(own)}
            row |= {start: own.loc[own["start"] == start, "ratio"].max() for start in STARTS}
            row |= {"beyond": int((own["ratio"] > 1).sum()), "printed": loose["ratio"].max()}
            rows.append(row | {"beyond it": int((loose["ratio"] > 1).sum())})
    data = pd.DataFrame(rows)
    without = [name for name in examination.scenes if name not in set(asked["scene"])]
    notes = [] if asked.empty else [_promise(asked, "‖A δx‖ ≤ ε₀ holds", "‖A δx‖ exceeds ε₀")]
    if len(printed):
        said = _promise(
            printed,
            "The tolerance as printed, ε₀/‖R⁻¹‖, would have been enough here: ‖A δx‖ ≤ ε₀ holds",
            "The tolerance as printed, ε₀/‖R⁻¹‖, does not do: ‖A δx‖ exceeds ε₀",
        )
        notes.append(
            f"{said}  Nothing guarantees it where ‖R⁻¹‖ is underestimated or R is old; the method "
            f"works with a {SAFETY:g}th of it."
        )
    if without:
        notes.append(f"{join(without)}: without a reference, or too large.")
    return Table(
        name="criterion_accuracy",
        title="‖A δx‖/ε₀ where ε₀ is asked",
        reading=(
            "The worst over all QPs with a reference, from each start: cold; warm, from the last "
            "QP; from the solution 5 and 20 QPs ago; and shaken, warm with a random force added "
            "to every QP.  lotstedt keeps R at every size, never keeps it as long as it "
            "can.  beyond counts the solves above 1; printed is the worst with the paper's ε₀ "
            f"in (3.20) instead of ε₀/{SAFETY:g}, and beyond it counts again."
        ),
        data=data,
        formats={
            **dict.fromkeys(["solves", "beyond", "beyond it"], whole),
            **dict.fromkeys([*STARTS, "printed"], short),
        },
        notes=notes,
    )


def _promise(rows: pd.DataFrame, kept: str, broken: str) -> str:
    """Whether the ratio stays below 1, and its worst."""
    beyond, worst = int((rows["ratio"] > 1).sum()), rows.loc[rows["ratio"].idxmax()]
    where = (
        f"{worst['scene']}, QP {worst['place']}, {worst['solver']}, {worst['start']}, "
        f"descent directions {worst['directions']}, age of R {worst['age']}"
    )
    if beyond:
        said = f"{broken} in {beyond:,} of {len(rows):,} solves"
    else:
        said = f"{kept} in all {len(rows):,} solves"
    return f"{said}; the worst ratio is {short(worst['ratio'])} ({where})."


def directions_table(examination: Examination) -> Table:
    """‖A δx‖/ε₀ by descent directions and age of R, over all recordings and starts."""
    asked, printed = _asked(examination)
    ages = {"any": (-1, 10**9), "0": (0, 0), **AGES, "1–5": (1, 5)}
    rows = []
    for solver in SOLVERS:
        names = ["any"] if solver == METHOD else ["0", "1–5", "6–20", "> 20"]
        for name in names:
            row: dict[str, Any] = {"solver": solver, "age of R": name}
            own, loose = (
                rows_of[(rows_of["solver"] == solver) & rows_of["age"].between(*ages[name])]
                for rows_of in (asked, printed)
            )
            for head, (first, last) in _DIRECTIONS.items():
                ratios = own.loc[own["directions"].between(first, last), "ratio"]
                row |= {head: len(ratios), f"worst {head}": ratios.max()}
            rows.append(row | {"printed": loose["ratio"].max()})
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_directions",
        title="‖A δx‖/ε₀ by descent directions and age of R",
        reading=(
            "All recordings and starts.  0, 1, 2 and ≥ 3 are the solves that took so many descent "
            "directions, each with its worst ‖A δx‖/ε₀; printed is the worst of them with the "
            "paper's own tolerance.  Impulses always work with today's R, of age 0."
        ),
        data=data,
        formats={
            **dict.fromkeys(_DIRECTIONS, whole),
            **{f"worst {head}": short for head in _DIRECTIONS},
            "printed": short,
        },
        notes=_direction_notes(asked),
    )


_DIRECTIONS = {"0": (0, 0), "1": (1, 1), "2": (2, 2), "≥ 3": (3, 10**9)}


def _direction_notes(asked: pd.DataFrame) -> list[str]:
    """What is known of several directions on an old R, and how much of it was provoked."""
    kept = asked[(asked["solver"] != METHOD) & (asked["age"] > 0) & (asked["directions"] > 1)]
    if kept.empty:
        return ["No QP took several directions on an old R."]
    usual = kept["start"].isin(["cold", "warm"])
    notes = [
        f"Several directions on an old R: {len(kept):,} solves, the worst ratio "
        f"{short(kept['ratio'].max())}; {int(usual.sum()):,} of them from the start that a "
        "simulation has"
        + (f" (worst {short(kept.loc[usual, 'ratio'].max())})" if usual.any() else "")
        + ", the others from stale starts and shaken QPs."
    ]
    thin = []
    for head, (first, last) in list(_DIRECTIONS.items())[2:]:
        natural = kept[usual & kept["directions"].between(first, last)]
        if len(natural) < THIN:
            thin.append(f"{head} directions ({len(natural)})")
    if thin:
        notes.append(
            f"In a simulation they are too rare to judge by: {join(thin)}.  The stale and shaken "
            "starts are there for that."
        )
    return notes


def _asked(examination: Examination) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The solves at ε₀ and those at the tolerance as printed."""
    rows = examination.accuracy
    return rows[rows["asked"] == 1.0], rows[rows["asked"] != 1.0]


def _by_columns(examination: Examination) -> list[tuple[str, str, pd.DataFrame]]:
    """(scene, "free" or "all", its rows) of every recording, where something is independent."""
    found = []
    for (_, scene), norms in examination.norms.groupby(["digest", "scene"], sort=False):
        for columns in ("free", "all"):
            chosen = norms[(norms["columns"] == columns) & (norms["qr_rank"] > 0)]
            if len(chosen):
                found.append((scene, columns, chosen))
    return found


def _too_large(examination: Examination) -> list[str]:
    known = examination.recordings
    scenes = list(known.loc[~known["digest"].isin(examination.norms["digest"]), "scene"])
    return [f"{join(scenes)}: A is too large for singular values of every QP."] if scenes else []
