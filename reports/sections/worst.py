"""The worst QPs of every backend, each with the command that shows it again."""

from __future__ import annotations

import shlex

import pandas as pd

from reports.parts.table import Table, scientific
from reports.rows.results import Results

WORST = 3
"""Rows of each backend on each scene."""
COLUMNS = ["solver", "scene", "QP", "setting", "arm", "verdict", "error", "bound", "status",
           "command"]  # fmt: skip


def worst_table(results: Results) -> Table:
    """What is not verified first, then by the error over the accuracy asked."""
    rows = results.rows[~results.rows["skipped"]]
    ordered = rows.sort_values(
        ["verified", "asked_ratio"], ascending=[True, False], kind="stable", na_position="last"
    )
    chosen = ordered.groupby(["solver", "scene"], sort=True, as_index=False).head(WORST)
    chosen = chosen.sort_values(["solver", "scene"], kind="stable")
    return Table(
        name="worst",
        title="The worst QPs of every backend",
        reading=(
            f"At most {WORST} of each backend on each scene: first what is not verified, then by "
            "the error.  Error and bound are in ‖A δx‖ over the accuracy asked; the bound needs "
            "no reference."
        ),
        data=pd.DataFrame([_entry(row) for row in chosen.to_dict("records")], columns=COLUMNS),
        formats={"error": scientific, "bound": scientific},
    )


def _entry(row: dict[str, object]) -> dict[str, object]:
    number = int(str(row["problem"]).rpartition("/")[2])
    bound = float(str(row["error_bound"])) * float(str(row["scale"])) / float(str(row["asked"]))
    return {
        "solver": row["solver"], "scene": row["scene"], "QP": number, "setting": row["settings"],
        "arm": row["arm"], "verdict": row["verdict"], "error": row["asked_ratio"], "bound": bound,
        "status": row["status_text"], "command": command_of(row, number),
    }  # fmt: skip


def command_of(row: dict[str, object], number: int) -> str:
    """What solves and shows one stored row again."""
    return shlex.join([
        "glambda", "replay", f"recordings/{row['scene']}.h5", "--solvers", str(row["solver"]),
        "--settings", str(row["settings"]), "--arms", str(row["arm"]), "--qp", str(number),
    ])  # fmt: skip
