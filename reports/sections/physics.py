"""What each backend's answers are worth as physics (`harness.judging.physics`), from the stored
rows."""

from __future__ import annotations

import numpy as np
import pandas as pd

from reports.parts.names import solver_order
from reports.parts.table import Table, scientific, whole
from reports.rows.results import Results

WORST = {
    "approach": "approach [m/s]",
    "pull": "pull [N]",
    "coulomb_excess": "Coulomb excess [N]",
    "work_error": "forbidden work [J]",
    "energy_error": "energy [J]",
}
"""Columns of the rows of which the worst is told, and what they are called."""


def physics_table(results: Results, setting: str) -> Table:
    """The worst of each backend over all scenes and arms at one setting."""
    rows = results.rows
    absent = [name for name in (*WORST, "physics_error") if name not in rows.columns]
    rows = rows[(rows["settings"] == setting) & (rows["k"] > 0) & ~rows["skipped"]]
    out = []
    for solver, part in rows.groupby("solver") if not absent else []:
        answered = part.dropna(subset="physics_error")
        worst = {label: answered[name].abs().max() for name, label in WORST.items()}
        out.append(
            {
                "solver": solver,
                "answers": len(answered),
                **worst,
                "without units, median": answered["physics_error"].median(),
                "max": answered["physics_error"].max(),
            }
        )
    names = ["solver", "answers", *WORST.values(), "without units, median", "max"]
    data = pd.DataFrame(
        sorted(out, key=lambda row: solver_order(str(row["solver"]))), columns=names
    )
    return Table(
        name="physics",
        key={"setting": setting},
        title="Physics of the answers",
        reading=(
            "The worst over all scenes and arms.  approach: bodies in contact that still move "
            "into each other after the step.  pull: contacts that hold bodies together (N s in an "
            "impulse).  Coulomb excess: |λ_F| beyond μ Σ λ_N of the answer itself; the exact "
            "answer has one too, since its bounds are lagged and λ is not always unique.  "
            "forbidden work: of forces at contacts that part, and of friction that is short of "
            "its bound where it slips.  energy: kinetic energy beyond the reference's.  The last "
            "two are the worst of all but Coulomb's, without units."
        ),
        data=data.replace({np.inf: np.nan}),
        formats={"answers": whole, **dict.fromkeys(names[2:], scientific)},
    )
