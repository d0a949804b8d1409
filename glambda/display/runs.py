"""How a simulation ended."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from problems.networks.run import NetworkRun
from problems.space.run import SpaceRun
from reports.parts.terminal_table import terminal_table

EVENTS_SHOWN = 5
"""Most events of a kind that are told of a simulation."""
TOLD = {"gain": "gain of friction", "overlap": "overlap"}
"""Kinds of event that are told one by one, and in which words."""
JAM = "  jam: friction whose gain is 1 or more stops contacts at once, as an impulse would"
WEDGED = "; impulses without friction (mu_I = 0) leave wedged bodies sliding, and it catches them"
"""What a jam is, and where most come from: with mu_I = mu they are rare."""


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
