"""What a recording holds."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from glambda.display.rows import share
from harness.criterion.cost_model import criterion_of
from harness.judging.facts import UNKNOWN, rank_of
from harness.recordings.recording import Recording
from problems.qp import KINDS
from reports.sections.protocol import proofs


def print_recording(console: Console, recording: Recording, path: str) -> None:
    """What a recording holds."""
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
            ("rank deficient", f"{deficient} of {len(ranked)} ({share(deficient, len(ranked))})"),
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
