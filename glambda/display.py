"""What the command line prints: tables of scenes, solvers, recordings, rows and misses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table
from rich.text import Text

from harness.judging.facts import SETTINGS
from harness.passes.starts import EVERY_ARM
from harness.recordings.recording import Recording
from harness.study.verify import ACCURATE_CLASS
from problems.networks.run import NetworkRun
from problems.qp import KINDS
from problems.space.run import SpaceRun
from reports.parts.terminal_table import terminal_table
from reports.sections.protocol import proofs
from solvers.registry import SolverInfo

EVENTS_SHOWN = 5
"""Most events of a kind that are told of a simulation."""
SCREEN = 36
"""Lines that are seen at once on a terminal of usual size."""
TOLD = {"gain": "gain of friction", "overlap": "overlap"}
"""Kinds of event that are told one by one, and in which words."""
JAM = "  jam: friction whose gain is 1 or more stops contacts at once, as an impulse would"
WEDGED = "; impulses without friction (mu_I = 0) leave wedged bodies sliding, and it catches them"
"""What a jam is, and where most come from: with mu_I = mu they are rare."""


def scenes_table(kind: str, described: Mapping[str, tuple[str, Mapping[str, Any]]]) -> Table:
    """Scenes of a kind, with what they are and their parameters."""
    return terminal_table(
        f"Scenes: {kind}",
        ("name", "what it is and its parameters"),
        (
            (name, f"{summary}\n" + ", ".join(f"{k}={v}" for k, v in defaults.items()))
            for name, (summary, defaults) in described.items()
        ),
    )


def solvers_table(described: Sequence[SolverInfo]) -> Table:
    """Solvers that are here, with what they are fed and what a warm start carries."""
    return terminal_table(
        "Solvers (* held to miss no A x at all)",
        ("name", "version", "what it is, is fed, carries over and adds"),
        (
            (
                f"{s.name}*" if s.name in ACCURATE_CLASS else s.name,
                f"{s.package} {s.version}",
                f"{s.summary}\nform: {s.form}; warm start: {s.warm_start}; adds: "
                f"{s.regularisation}" + (f"\nvariants: {s.variants}" if s.variants else ""),
            )
            for s in described
            if s.available
        ),
    )


def print_recording(console: Console, recording: Recording, path: str) -> None:
    """What a recording holds."""
    from harness.criterion.cost_model import criterion_of
    from harness.judging.facts import UNKNOWN, rank_of

    qps = recording.qps
    kinds = ", ".join(
        f"{sum(qp.kind == kind for qp in qps)} {kind}"
        for kind in KINDS
        if any(qp.kind == kind for qp in qps)
    )
    ranked = [(rank, qp.k) for qp in qps if (rank := rank_of(qp)) != UNKNOWN]
    deficient = sum(rank < k for rank, k in ranked)
    criterion = criterion_of(recording)
    events: dict[str, int] = {}
    for event in recording.events:
        events[event.kind] = events.get(event.kind, 0) + 1
    lines: list[tuple[str, Any]] = [
        ("file", path),
        ("scene", recording.scene),
        ("parameters", ", ".join(f"{k}={v}" for k, v in recording.parameters.items())),
        ("digest", recording.digest),
        ("made by", recording.code_version),
        ("motion", _motion(recording)),
        ("counts", ", ".join(f"{v} {k}" for k, v in recording.counts.items())),
        ("events", ", ".join(f"{v} {k}" for k, v in sorted(events.items())) or "none"),
        ("QPs", f"{len(qps)}: {kinds}" if qps else "none"),
        *([("with discs", str(len(recording.discs)))] if recording.discs else []),
    ]
    if qps:
        sizes = [(qp.m, qp.k) for qp in qps]
        lines += [
            ("sizes", f"m ≤ {max(m for m, _ in sizes)}, k ≤ {max(k for _, k in sizes)}"),
            ("rank deficient", f"{deficient} of {len(ranked)} ({_share(deficient, len(ranked))})"),
            ("references", proofs(recording.references)),
            (
                "criterion",
                f"C_QR {criterion.C_QR:.0f}, C_IT {criterion.C_IT:.0f} flops, "
                f"√(2 C_QR/C_IT) = {criterion.threshold:.2f}",
            ),
        ]
    for name, value in lines:
        console.print(Text(f"{name:15s} {value}"), soft_wrap=True)


def _motion(recording: Recording) -> str:
    if not len(recording.t):
        return "none"
    where = "" if recording.space is None else " in space"
    return f"t = {recording.t[0]:g} to {recording.t[-1]:g} s, {recording.bodies} bodies{where}"


def _print_findings(console: Console, run: Any) -> None:
    """Events that say something of the model or of the accuracy."""
    for kind, words in TOLD.items():
        found = [event for event in run.event_log if event.kind == kind]
        for event in found[:EVENTS_SHOWN]:
            console.print(Text(f"  t = {event.t:.6g} s: {words}, {event.detail}"))
        if len(found) > EVENTS_SHOWN:
            more = f"  and {len(found) - EVENTS_SHOWN} more; --trajectory keeps all events"
            console.print(Text(more))
    if any(event.kind == "jam" for event in run.event_log):
        console.print(Text(JAM + WEDGED if run.scene.mu_I == 0 else JAM))


def print_run(console: Console, run: Any) -> None:
    """How a simulation ended: counts, events and what some of them mean, where each body is."""
    counts = ", ".join(f"{v} {k.replace('_', ' ')}" for k, v in run.counts.items())
    rest = [event.t for event in run.event_log if event.kind == "rest"]
    end = f", at rest from t = {rest[-1]:.6g} s on" if rest else ""
    console.print(Text(f"{run.scene.label}: t = {run.t[-1]:.6g} s{end}; {counts}"))
    kinds = Counter(event.kind for event in run.event_log)
    if kinds:
        console.print(Text("events: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items())))
    if isinstance(run, NetworkRun):
        _print_network(console, run)
        return
    if isinstance(run, SpaceRun):
        _print_space(console, run)
        return
    _print_findings(console, run)
    last = run.trajectory.tail(run.q.shape[1])
    names = ["body", "x", "y", "phi", "vx", "vy", "omega"]
    console.print(
        terminal_table(
            "",
            tuple(f">{name}" for name in names),
            ([int(row[0]), *(f"{v:z.4f}" for v in row[1:])] for row in last[names].to_numpy()),
        )
    )


def _print_network(console: Console, run: NetworkRun) -> None:
    """Currents and voltages at the end."""
    last = zip(run.scene.names(), run.currents[-1], run.diode_voltages[-1], strict=True)
    console.print(
        terminal_table(
            "",
            ("branch", ">current [A]", ">λ of its diode [V]"),
            ([name, f"{i:z.4f}", f"{lam:z.4f}"] for name, i, lam in last),
        )
    )


def _print_space(console: Console, run: SpaceRun) -> None:
    """Where each body is at the end, and how it moves."""
    names = ("x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")
    last = np.hstack([run.poses[-1, :, :3], run.velocities[-1]])
    console.print(
        terminal_table(
            "",
            tuple(f">{name}" for name in ("body", *names)),
            ([body, *(f"{v:z.4f}" for v in row)] for body, row in enumerate(last, start=1)),
        )
    )


def replay_table(rows: pd.DataFrame) -> Table:
    """A line per solver and setting over all scenes; of more than a screen, of one setting only.

    That is the first of them, and then variants are left out, too: the report has all.
    """
    title = "Replayed (error: ‖A(x − x*)‖/scale; µs: median per QP)"
    if rows.groupby(["solver", "settings"]).ngroups > SCREEN:
        there = sorted(set(rows["settings"]))
        first = next((name for name in SETTINGS if name in there), there[0])
        rows = rows[rows["settings"] == first]
        if rows["solver"].nunique() > SCREEN:
            rows = rows[~rows["solver"].str.contains("[", regex=False)]
        title += f"; here at {first}, the report has all"
    arms = [arm for arm in EVERY_ARM if arm in set(rows["arm"])]
    lines = []
    for (solver, setting), part in rows.groupby(["solver", "settings"], sort=True):
        done = part[part["verdict"] != "skipped"]
        lines.append(
            (
                *(solver, setting, len(done), len(part) - len(done)),
                _share(int((done["verdict"] == "verified").sum()), len(done)),
                int((done["verdict"] == "undecided").sum()),
                _scientific(done["glambda_error"].max()),
                *(
                    _scientific(1e6 * done["runtime"][done["arm"] == arm].median(), "{:.1f}")
                    for arm in arms
                ),
            )
        )
    columns = (
        *("solver", "setting", ">QPs", ">skipped", ">verified", ">undecided", ">max error"),
        *(f">µs {arm}" for arm in arms),
    )
    return terminal_table(title, columns, lines)


def _share(part: int, whole: int) -> str:
    """A percentage that says 100 % of all only, and 0 % of none only."""
    if whole == 0:
        return "–"
    if part in (0, whole):
        return f"{part / whole:.0%}"
    return f"{min(max(part / whole, 0.001), 0.999):.1%}"


def misses_table(lines: pd.DataFrame, title: str) -> Table:
    """Lines of `harness.study.verify.misses`."""
    return terminal_table(
        title,
        (
            *("scene", "solver", "setting", ">solved", ">skipped", ">missed", ">expected"),
            *(">worst/asked", "reason"),
        ),
        (
            (
                line.scene,
                line.solver,
                line.settings,
                line.solves,
                line.skipped,
                line.missed,
                "–" if pd.isna(line.expected) else line.expected,
                _scientific(line.worst),
                line.reason,
            )
            for line in lines.itertuples()
        ),
    )


def print_row(console: Console, row: Mapping[str, Any]) -> None:
    """Every column of one solve."""
    for name, value in row.items():
        if isinstance(value, np.ndarray):
            value = np.array2string(value, max_line_width=80)
        if value is not None:
            console.print(Text(f"{name:20s} {value}"), soft_wrap=True)


def _scientific(value: float, form: str = "{:.1e}") -> str:
    return "–" if value is None or np.isnan(value) else form.format(value)
