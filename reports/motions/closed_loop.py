"""What `glambda closed-loop` prints and writes: what a solver does to the motion.

    closed_loop              every loop: error, events, steps, overlap, energy, Signorini, accuracy
    closed_loop_reference    how good the reference is, and what the error of ε is
    closed_loop_sloppy       error of the motion against the accuracy of the answers

Three figures (`reports.motions.closed_loop_figures`); one page, closed_loop.md: what was found, in
sentences made from the numbers (`reports.motions.closed_loop_findings`), and what the columns are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.text import Text

from harness.machine.machine import machine_label
from harness.motions.closed_loop import Findings
from harness.motions.in_loop import NOISES, SLOPPY
from harness.motions.motion_error import APART, MATCHED_KINDS, WINDOW
from reports.motions.closed_loop_figures import plot_accuracy, plot_physics, plot_separation
from reports.motions.closed_loop_findings import (
    AS_GOOD,
    as_large_as_eps,
    discretization,
    findings_of,
    harmless,
    metres,
    own_error,
)
from reports.parts.style import draw_files
from reports.parts.table import (
    Table,
    percent,
    print_tables,
    short,
    times,
    whole,
    write_page,
)


def seconds(value: Any) -> str:
    """A time in the motion."""
    return f"{float(value):.3f}"


def reference_table(found: Sequence[Findings]) -> Table:
    """How good the references are."""
    rows = []
    for each in found:
        twin, check = discretization(each), each.check_error.largest(each.common)
        rows.append(
            {
                "scene": each.scene,
                "ε": each.eps,
                "ends": each.reference.reached,
                "judged to": each.common,
                "steps at ε": each.twin.measures["steps"],
                "check": each.check.measures["steps"],
                "reference": each.reference.measures["steps"],
                "check off by": check,
                "reference off by": own_error(each),
                "error of ε": twin,
                "to first impact": each.twin_error.largest(each.first_impact),
                "apart": each.twin_error.apart,
                "check apart": each.check_error.apart,
            }
        )
    return Table(
        name="closed_loop_reference",
        title="The reference, and the error of ε",
        reading=(
            "exact QPs (our method at 1e-12 of the scale) at ε, at the smaller ε of the "
            "check and at the ten times smaller one of the reference. check off by: its distance "
            "from the reference; the reference itself is off by a ninth of that, the error being "
            "proportional to ε. error of ε: what exact QPs at ε leave. All up to the time that "
            "loops are judged to: the end, or the last impact before exact QPs at ε (apart) or the "
            f"check (check apart) are more than {metres(APART)} off."
        ),
        data=pd.DataFrame(rows),
        formats={
            "ε": short, "ends": seconds, "judged to": seconds, "apart": seconds,
            "check apart": seconds,
            **dict.fromkeys(["steps at ε", "check", "reference"], whole),
            **dict.fromkeys(
                ["check off by", "reference off by", "error of ε", "to first impact"], metres
            ),
        },
    )  # fmt: skip


def sloppy_table(found: Sequence[Findings]) -> Table:
    """Error of the motion under solvers that are wrong by so much."""
    rows = []
    sweep: list[str] = []
    for each in found:
        for name in SLOPPY:
            own = each.rows[each.rows["solver"] == name]
            if not len(own):
                continue
            ended = own["error"].where(own["verdict"] == "finished")
            errors = dict(zip(own["setting"], ended, strict=True))
            sweep += [setting for setting in errors if setting not in sweep]
            noise = name[len("sloppy[") : -1]
            limit = harmless(each, name)
            full = 1 - each.twin.measures["rank_deficient"]
            row = {"scene": each.scene, "rank": full, "δx": noise, **errors}
            rows.append({**row, "harmless to": limit, "as ε at": as_large_as_eps(each, name)})
    columns = ["scene", "rank", "δx", *sweep, "harmless to", "as ε at"]
    return Table(
        name="closed_loop_sloppy",
        title="Answers that are wrong by a known amount",
        reading=(
            "largest pose error up to the time judged to, where every answer is x* + δx with "
            "‖A δx‖ that many times the ε₀ of its QP. δx is random over all rows (any), over those "
            "between their bounds (free) or over those at a bound, off it (inside, like an "
            "interior-point method); or along x* so that forces are too large (more) or too small "
            "(less). rank: share of the QPs of time steps whose λ is unique; where it is not, "
            "‖A δx‖ does not bound δλ, and λ_N bounds friction. harmless to: the largest multiple "
            f"up to which the error stays within {times(AS_GOOD)} the error of ε. as ε at: the "
            "multiple at which the motion is as far from that of exact QPs as ε puts them from the "
            "reference. An en dash: none, or the motion did not come to its end."
        ),
        data=pd.DataFrame(rows, columns=columns),
        formats={
            **dict.fromkeys(sweep, metres),
            "rank": percent,
            "harmless to": "{:g}x".format,
            "as ε at": _multiple,
        },
    )


def motion_table(each: Findings) -> Table:
    """One scene: how near the motions are."""
    rows = each.rows
    data = pd.DataFrame(
        {
            "solver": rows["solver"],
            "setting": rows["setting"],
            "verdict": rows["verdict"],
            "reached": rows["reached"],
            "first impact": rows["error_first"],
            "error": rows["error"],
            "rms": rows["rms"],
            "from exact": rows["from_twin"],
            "to the end": rows["error_end"],
            "apart": rows["apart"],
            "events": rows["matched"],
            "missing": rows["missing"],
            "extra": rows["extra"],
            "event error": rows["event_error"],
            "mismatch": rows["mismatch"],
        }
    )
    lengths = ["first impact", "error", "rms", "from exact", "to the end"]
    return Table(
        name="closed_loop_motion",
        title="The motion",
        key={"scene": each.scene},
        reading=(
            "pose error against the reference: the largest up to the first impact "
            f"({seconds(each.first_impact)} s), the largest and the root mean square up to "
            f"{seconds(each.common)} s, where exact QPs at this ε are still with it, and the "
            "largest to the end. from exact: distance to exact QPs at the same ε, which is the "
            f"solver's own doing. apart: when it is {metres(APART)} off [s]. events: "
            f"{', '.join(MATCHED_KINDS)} that have a partner within {1000 * WINDOW:g} ms in the "
            "reference, those without one on either side, the largest time between partners, and "
            "the first without one [s]."
        ),
        data=data,
        formats={
            **dict.fromkeys(lengths, metres),
            **dict.fromkeys(["events", "missing", "extra"], whole),
            **dict.fromkeys(["reached", "apart", "mismatch"], seconds),
            "event error": _milliseconds,
        },
        notes=[
            f"{row.solver} at {row.setting}: {row.reason}."
            for row in rows.itertuples()
            if row.reason
        ],
    )


def _multiple(value: Any) -> str:
    return f"{short(value)}x"


def _milliseconds(value: Any) -> str:
    return f"{short(1000 * float(value))} ms"


def print_closed_loop(console: Console, found: Sequence[Findings]) -> None:
    """Print what was found, and as much of the tables as fits a terminal."""
    for sentence in findings_of(found):
        console.print(Text(f"- {sentence}"))
    console.print()
    tables = [sloppy_table(found), *(motion_table(each) for each in found)]
    narrow = [
        replace(t, data=t.data[[name for name in t.data if name not in LEFT_OUT]])
        for t in tables
        if len(t.data)
    ]
    print_tables(console, narrow)


LEFT_OUT = ("first impact", "rms", "to the end", "mismatch", "rank")
"""Columns that are not printed."""
COLUMNS = {
    "verdict, reason, reached": "how the loop ended, why if too early, and when [s].",
    "error_first, error, error_end": "largest pose error against the reference [m] up to the first "
    "impact, up to the time judged to, to the end; rms likewise.",
    "from_twin": "largest distance to exact QPs at the same ε [m], the solver's own doing.",
    "apart": f"when it is {metres(APART)} off [s].",
    "matched, missing, extra": f"{', '.join(MATCHED_KINDS)} that have a partner within "
    f"{1000 * WINDOW:g} ms in the reference, and those without one on either side; event_error: "
    "the largest time between partners, mismatch: the first without one [s].",
    "eps0_ratio, impulse_ratio": "the largest ‖A(x − x*)‖ of an answer in multiples of what its QP "
    "needs: ε₀; 1e-10 of the momentum for an impulse.",
    "missed": "answers beyond ten times that which the solver calls solved.",
    "overlap, reach": "the deepest overlap of two parts, and the largest gap across which a "
    "contact pushes [m].",
    "approach, pull": "largest −g_Nᵀq̇ [m/s] and −λ_N [N] at the end of a step.",
    "pumped": "work of contact forces on contacts that separate [J].",
    "gained_at_steps, gained_at_impulses, lost_at_impulses": "by how much T + V rises and falls "
    "[J]; energy_end: what is left at the end, less the reference's; peak_kinetic: the largest T.",
    "call_time, wall_time": "spent in the solver's calls, and in all [s].",
}
"""What closed_loop.csv holds, beside counts that bear their names."""
FIGURES = (
    ("closed_loop_accuracy", "Error of the motion against the worst answer", plot_accuracy),
    ("closed_loop_separation", "Pose error in time", plot_separation),
    (
        "closed_loop_physics",
        "Overlap, reach and energy pumped in, against accuracy",
        plot_physics,
    ),
)


def write_closed_loop(found: Sequence[Findings], folder: str | Path) -> Path:
    """Write closed_loop.md, closed_loop.csv, the figures and one CSV per table; return the page."""
    folder = Path(folder)
    rows = pd.concat([each.rows for each in found], ignore_index=True)
    tables = [table for table in (reference_table(found), sloppy_table(found)) if len(table.data)]
    for name, _, plot in FIGURES:
        draw_files(partial(plot, found), folder / name)
    page = folder / "closed_loop.md"
    return write_page(page, _page(found, tables), tables, {"closed_loop": rows})


def _page(found: Sequence[Findings], tables: Sequence[Table]) -> str:
    backends = {s for each in found for s in each.rows["solver"]} - set(SLOPPY)
    introduction = (
        f"Each of {len(backends)} backends drives {len(found)} scenes: its answers make its own "
        "next QPs. The motions are compared with a fine reference and with exact QPs at the same "
        f"ε; and so are {len(NOISES)} kinds of solvers whose answers are wrong by a known amount. "
        f"Made on {machine_label()}."
    )
    said = "\n".join(f"- {sentence}" for sentence in findings_of(found))
    pictures = [f"![{caption}]({name}.png)\n" for name, caption, _ in FIGURES]
    return "\n".join(
        [
            "# What a sloppy solver does to the motion\n",
            introduction + "\n",
            said + "\n",
            *pictures,
            *(table.to_markdown() for table in tables),
            "## Every loop\n",
            "A row each is in [closed_loop.csv](closed_loop.csv).\n",
            *(f"- {names}: {meaning}" for names, meaning in COLUMNS.items()),
            "",
        ]
    )
