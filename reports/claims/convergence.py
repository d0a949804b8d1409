"""The error of a motion against ε, and what is done about drift, as a page.

convergence.png    errors against ε, time against error, drift against τ
convergence.md     the same with tables;  convergence_*.csv  their numbers, and those of every run
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from harness.claims.convergence import FINE, Converged, costs, exponents, fit
from harness.claims.reference_motion import BOUNDS, DROP_TOL, LATE, REFERENCE, STOCK
from harness.claims.stabilization import SHALLOW
from harness.peers.ours import BOUNDED
from reports.claims.convergence_figure import plot_convergence
from reports.parts.table import Table, scientific, short, whole, write_page

OFF = 0.1
"""Distance of an exponent from 1 that is spoken of."""
WORDS = {
    "smooth": "before any event",
    "before": "before the first impact",
    "after": "after the first impact",
    "late": "after some impacts",
}


def convergence_tables(measured: Converged) -> list[Table]:
    """The tables in the order of the page."""
    return [
        exponents_table(measured.swept),
        errors_table(measured.swept),
        costs_table(measured.swept),
        drift_table(measured.drifted),
    ]


# --- the sweep of ε -------------------------------------------------------------------------------


def exponents_table(swept: pd.DataFrame) -> Table:
    """p of error = C εᵖ by scene, bound of h and stretch of time."""
    found = exponents(swept)
    data = found.rename(
        columns={"spread": "±", "fine": f"p, ε ≤ {FINE:.0e}", "its spread": "± of it"}
    )
    notes = [_range_of(found[found["bound"] == bound], bound) for bound in BOUNDS]
    bounded = found[(found["bound"] == BOUNDED) & ((found["fine"] - 1).abs() > OFF)]
    notes.extend(
        f"{row.scene} {WORDS[row.stretch]}, {BOUNDED}: the exponent is {exponent(row.fine)} for "
        f"ε ≤ {FINE:.0e}, and between neighbours in ε from {exponent(row.least)} to "
        f"{exponent(row.largest)}."
        for row in bounded.itertuples()
    )
    notes.extend(_floors(swept, found))
    return Table(
        name="convergence_exponents",
        title="Is the error proportional to ε?",
        reading=(
            f"Before any event (smooth), before the first impact, from it to impact {LATE}, later: "
            "error = C εᵖ, fitted to poses: p with its standard error, the least and largest p "
            "between two neighbours in ε, the number of ε with an error above rounding, p of the "
            "small ε alone, C the geometric mean of error/ε; then p of velocities. (3.5) is an "
            "error per unit step: theory has p = 1."
        ),
        data=data,
        formats={
            **dict.fromkeys(data.columns.drop(["scene", "bound", "stretch"]), exponent),
            "points": whole, "C": short,
        },
        notes=notes,
    )  # fmt: skip


def exponent(p: float) -> str:
    """Two digits, and no minus before 0."""
    return f"{round(p, 2) + 0.0:.2f}"


def _range_of(found: pd.DataFrame, bound: str) -> str:
    parts = []
    for stretch in ("before", "after", "late"):
        fine = found[found["stretch"] == stretch]["fine"].dropna()
        if fine.size:
            near = int(((fine - 1).abs() <= OFF).sum())
            parts.append(
                f"{WORDS[stretch]} p is from {exponent(fine.min())} to {exponent(fine.max())}, in "
                f"{near} of {fine.size} scenes within {OFF:g} of 1"
            )
    return f"{bound}, ε ≤ {FINE:.0e}: {'; '.join(parts)}."


def _floors(swept: pd.DataFrame, found: pd.DataFrame) -> list[str]:
    """Where ε alone does not bring the error down."""
    notes = []
    fine = found.set_index(["scene", "stretch", "bound"])["fine"]
    level = found[(found["bound"] == STOCK) & (found["fine"] < 0.5)]
    for row in level.drop_duplicates("scene").itertuples():
        part = swept[(swept["scene"] == row.scene) & (swept["stretch"] == row.stretch)]
        finest = part[part["eps"] == part["eps"].min()].set_index("bound")["pose"]
        cured = abs(fine[row.scene, row.stretch, BOUNDED] - 1) <= OFF
        notes.append(
            f"{row.scene} {WORDS[row.stretch]}: ε alone does not bring the error down; at "
            f"ε = {part['eps'].min():.0e} it is {finest[STOCK]:.1e}, with {BOUNDED} "
            f"{finest[BOUNDED]:.1e}. "
            + (
                "The bound of h does: a jump of q⃛ that nothing announces, as where a contact lets "
                "go, is else crossed by a step of h_max."
                if cured
                else "Nor does the bound make it proportional to ε"
                + (
                    "."
                    if row.stretch == "before"
                    else ": an event is placed by a tolerance that ε does not set."
                )
            )
        )
    return notes


def errors_table(swept: pd.DataFrame) -> Table:
    """Pose errors by ε, whole decades."""
    keys = ["scene", "bound", "stretch"]
    return Table(
        name="convergence_errors",
        title="Pose errors by ε",
        reading="Largest ‖δ(x, y)‖ + R |δφ| [m] over bodies and times, one column per ε.",
        data=_by_decade(swept, keys, "pose"),
        formats=dict.fromkeys(_decades(swept), scientific),
    )


def costs_table(swept: pd.DataFrame) -> Table:
    """Steps by ε, and the CPU time."""
    spent = costs(swept)
    keys = ["scene", "bound"]
    data = _by_decade(spent, keys, "steps")
    groups = [part for _, part in spent.groupby(keys, sort=False)]
    small = [part[part["eps"] <= FINE] for part in groups]
    data["steps ∝ ε^"] = [fit(part["eps"], part["steps"]).p for part in small]
    data["cpu, coarsest"] = [part["cpu"].iloc[0] for part in groups]
    data["cpu, finest"] = [part["cpu"].iloc[-1] for part in groups]
    notes = []
    for (label, bound), part in spent.groupby(keys, sort=False):
        last = part["impulses"].iloc[-1]
        other = part[part["impulses"] != last]
        if len(other) and bound == BOUNDED:
            told = ", ".join(f"{row.impulses} at {row.eps:.1e}" for row in other.itertuples())
            notes.append(
                f"{label}, {bound}: {last} impulses at ε = {part['eps'].iloc[-1]:.0e}, but {told}."
            )
    return Table(
        name="convergence_costs",
        title="What ε costs",
        reading=(
            "Accepted steps, one column per ε; the power of ε in them where it is small "
            f"(ε ≤ {FINE:.0e}; theory: −1/2); CPU time [s] "
            "of a run at the coarsest and at the finest ε."
        ),
        data=data,
        formats={
            **dict.fromkeys(_decades(swept), whole), "steps ∝ ε^": exponent,
            "cpu, coarsest": short, "cpu, finest": short,
        },
        notes=notes,
    )  # fmt: skip


def _decades(swept: pd.DataFrame) -> list[str]:
    """Names of the columns of whole decades of ε."""
    return [f"{eps:.0e}" for eps in sorted(swept["eps"].unique(), reverse=True) if _whole(eps)]


def _whole(eps: float) -> bool:
    return bool(np.isclose(np.log10(eps) % 1, [0, 1], atol=1e-9).any())


def _by_decade(table: pd.DataFrame, keys: list[str], values: str) -> pd.DataFrame:
    """One row per keys in their order, one column per decade of ε."""
    kept = table[[_whole(eps) for eps in table["eps"]]]
    order = list(dict.fromkeys(kept[keys].itertuples(index=False, name=None)))
    data = kept.pivot(index=keys, columns="eps", values=values).loc[order]
    data = data[sorted(data.columns, reverse=True)]
    data.columns = [f"{eps:.0e}" for eps in data.columns]
    return data.reset_index()


# --- drift ----------------------------------------------------------------------------------------


def drift_table(drifted: pd.DataFrame) -> Table:
    """Gaps, motion, energy, steps and time of every rule."""
    deepest = drifted.groupby("scene", sort=False)["depth"].max()
    still = deepest.index[deepest < SHALLOW].tolist()
    moving = drifted[~drifted["scene"].isin(still)]
    data = moving.drop(columns=["drift", "tau"]).rename(
        columns={"before": "pose, before", "after": "pose, after"}
    )
    notes = drift_findings(moving) if len(moving) else []
    if still:
        notes.append(f"No drift above rounding: {', '.join(still)}.")
    return Table(
        name="convergence_drift",
        title="What is done about drift",
        reading=(
            "By scene, ε and rule: −min φ of active contacts and the deepest overlap of any two "
            "parts [m]; mean |φ| of the contacts that bear a load at the end [m]; largest pose "
            "error before and after the first impact [m]; T + V at the end less that of the "
            "reference, over its largest T; accepted steps, events; CPU time [s], least of runs in "
            f"turn, and its ratio to no rule through the same code. {BOUNDED}."
        ),
        data=data,
        formats={
            "eps": scientific, "depth": scientific, "overlap": scientific, "gap": scientific,
            "pose, before": scientific, "pose, after": scientific, "energy": scientific,
            "steps": whole, "events": whole, "cpu": short, "ratio": "{:.2f}".format,
        },
        notes=notes,
    )  # fmt: skip


def drift_findings(drifted: pd.DataFrame) -> list[str]:
    """What each rule is worth, in a sentence of its own numbers."""
    table = drifted.set_index(["scene", "eps", "rule"])
    plain = table.xs("none", level="rule")
    # one error per run: that of all its times
    plain_pose = _pose(plain)
    notes = [
        "Without a rule, −min φ of active contacts is "
        f"{_span(plain['depth'] / plain.index.get_level_values('eps'))} ε."
    ]
    rules = [name for name in table.index.unique("rule") if not name.startswith("none")]
    for name in rules:
        part = table.xs(name, level="rule")
        notes.append(
            f"{name}: −min φ is {_span(part['depth'] / plain['depth'])} times that without, "
            f"the pose error {_span(_pose(part) / plain_pose)} times, |energy error| "
            f"{_span(part['energy'].abs() / plain['energy'].abs())} times, CPU time "
            f"{_span(part['ratio'])} times."
        )
    compiled = table.xs("none, compiled", level="rule")["ratio"]
    notes.append(
        "Steps whose QPs are left to a compiled method, as no rule's are, take without one "
        f"{_span(compiled)} times the time: a rule costs that, too."
    )
    return notes


def _pose(part: pd.DataFrame) -> pd.Series:
    return part[["before", "after"]].max(axis=1)


def _span(ratios: pd.Series) -> str:
    """Median and range."""
    return f"{short(ratios.median())} ({short(ratios.min())} to {short(ratios.max())})"


# --- page -----------------------------------------------------------------------------------------


def write_convergence(measured: Converged, folder: str | Path) -> Path:
    """Write convergence.md, the tables, the runs and the figure; return the page."""
    folder = Path(folder)
    plot_convergence(measured, folder / "convergence.png")
    tables = convergence_tables(measured)
    return write_page(
        folder / "convergence.md",
        "# Error against ε, and drift\n\n"
        f"ε of (3.5) is swept with the drop threshold fixed at {DROP_TOL:g} m/s, and every motion "
        f"compared with that at ε = {REFERENCE:g}, once with h bounded by {STOCK} alone, and once "
        f"with {BOUNDED}: of an error that falls in proportion to ε under the second bound only, "
        "part is the bound's merit. Then contacts that drift, φ ≠ 0 under load, are left alone, "
        "stabilized by Baumgarte's rule, or projected.\n\n"
        "![Errors against ε, CPU time against error, gap and error against τ]"
        "(convergence.png)\n\n" + "\n".join(table.to_markdown() for table in tables),
        tables,
        {"convergence_runs": measured.swept},
    )
