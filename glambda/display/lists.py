"""Tables of what there is: scenes and solvers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from harness.study.expected_misses import ACCURATE_CLASS
from reports.parts.terminal_table import terminal_table
from solvers.registry import SolverInfo


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
