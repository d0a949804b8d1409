"""How the numbers of a report were measured, on what, and how to get them again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from reports.comparison import SHIFT, SKIP_LIMIT, TIME_LIMIT
from reports.results import ARMS, Results, in_order, solver_order
from reports.table import Table, percent, scientific, whole


def protocol(results: Results) -> list[tuple[str, str]]:
    """Terms and what they mean, with the constants that were used."""
    from harness.facts import ASKED_RELATIVE
    from harness.judge import VERIFIED_WITHIN, WRONG_BEYOND

    relative = " and ".join(f"{name} {value:g}" for name, value in ASKED_RELATIVE.items())
    said = [
        (
            "Replay",
            "Every backend sees the identical recorded QPs in order, whatever the others answer. "
            "Cold: each from nothing.  Warm: from its own previous answer, mapped by the identity "
            "of the rows, dropped after a discontinuity; impulses and minimum-norm problems are "
            "always solved cold.",
        ),
        (
            "Settings",
            "paper asks for ε₀ of (3.13), the accuracy that the step's error control needs; the "
            f"others are relative to the scale ‖A A⁺d‖ of the QP: {relative}, where default leaves "
            "each package at its own tolerances and only judges by that.",
        ),
        (
            "Verdict",
            "From x alone, by its error in Gλ against a checked reference, or by a bound on that "
            f"error where none was accepted.  Verified: up to {VERIFIED_WITHIN:g} times what was "
            f"asked.  Claimed wrong: beyond {WRONG_BEYOND:g} times, and called solved.",
        ),
        (
            "Time",
            "Setup and solve around the package's own call, one thread, the least over the "
            "passes; medians of the passes are in the results.",
        ),
        (
            "Means",
            f"Shifted geometric, shift {1e6 * SHIFT:g} µs.  A solve that is not verified is "
            f"charged {TIME_LIMIT:g} s.  Only over QPs that no compared backend skipped; one that "
            f"skipped more than {percent(SKIP_LIMIT)} of a scene is left out of it and named.",
        ),
    ]
    machines = sorted(results.rows["machine"].astype(str).unique())
    if machines:
        said.append(("Machine", "; ".join(machines)))
    return said


def versions_table(results: Results) -> Table:
    """Backends with their versions and how much they solved."""
    rows = results.rows
    out = []
    for solver in results.solvers:
        part = rows[rows["solver"] == solver]
        out.append(
            {
                "solver": solver,
                "versions": ", ".join(sorted(part["versions"].astype(str).unique())),
                "arms": ", ".join(in_order(part["arm"].unique(), ARMS)),
                "solves": int((~part["skipped"]).sum()),
                "skipped": int(part["skipped"].sum()),
            }
        )
    data = pd.DataFrame(sorted(out, key=lambda row: solver_order(str(row["solver"]))))
    return Table(
        name="versions",
        title="Backends and versions",
        reading="One line per backend, over all scenes, settings and arms.",
        data=data,
        formats={"solves": whole, "skipped": whole},
    )


def recordings_table(results: Results) -> Table:
    """Recordings with what identifies them."""
    out = []
    for scene, recording in results.recordings.items():
        chosen = {name: recording.parameters[name] for name in sorted(recording.parameters)}
        out.append(
            {
                "recording": scene,
                "ε": recording.eps,
                "digest": recording.digest[:16],
                "parameters": ", ".join(f"{name} = {value}" for name, value in chosen.items()),
            }
        )
    return Table(
        name="recordings",
        title="Recordings",
        reading="The digest is of the content: the same digest means the same QPs.",
        data=pd.DataFrame(out, columns=["recording", "ε", "digest", "parameters"]),
        formats={"ε": scientific},
    )


def reproduce(results: Results) -> str:
    """Commands that repeat this study."""
    lines = []
    for scene in results.scenes:
        recording = results.recordings.get(scene)
        lines.append(record_command(scene, {} if recording is None else recording.parameters))
    if len(results.rows):
        lines.append(
            f"glambda replay recordings/*.h5 --solvers '{','.join(results.solvers)}' \\\n"
            f"    --settings {','.join(results.settings)} "
            f"--arms {','.join(in_order(results.rows['arm'].unique(), ARMS))} -o results"
        )
        problem = str(results.rows["problem"].iloc[0])
        scene, _, number = problem.rpartition("/")
        solver = results.solvers[0]
        lines.append(
            f"glambda replay 'recordings/{scene}.h5' --solvers '{solver}' --qp {int(number)}"
            "      # one row again"
        )
    lines.append("glambda report results -o report")
    return "\n".join(lines)


def record_command(label: str, parameters: Mapping[str, Any]) -> str:
    """The command that records a scene, from its label such as "fig4,mu_I=0.8".

    parameters : of the recording; they tell whether it ended before the scene's own end
    """
    name, *chosen = label.split(",")
    options = "".join(f" --set {entry}" for entry in chosen)
    until = parameters.get("run.until")
    if until is not None and until != parameters.get("end_time"):
        options += f" --until {until:g}"
    return f"glambda record {name}{options} -o recordings"
